"""Details in which implementations of PPO differ, as a part of the learner."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
from brax.training.agents.ppo.networks import PPONetworks

from carpark_mj.training.ppo.loss import Weights, ppo_loss
from carpark_mj.training.ppo.parts import VARIANTS

if TYPE_CHECKING:
    from carpark_mj.training.ppo.config import PPOConfig

# Steps (time, agents, ...) to learn from, given actor and critic.
Prepare = Callable[[Any], Any]


class Variant:
    """Details of an update; these are Brax's.

    Attributes:
        normalizes: whether observations are normalised by their running statistics.
    """

    normalizes = True

    def check(self, config: "PPOConfig") -> None:
        """Refuses settings that the details are not made for.

        Raises:
            ValueError: naming the setting and what it needs.
        """

    def initial_weights(self, params: Any, key: jax.Array) -> tuple[Any, jax.Array]:
        """Actor and critic to start from, and a key for what follows.

        Args:
            params: as the networks draw them.
            key: consumed.
        """
        return params, key

    def prepared(
        self, prepare: Prepare, params: Any, networks: PPONetworks, normalizer: Any
    ) -> Prepare:
        """What every epoch calls for its steps, which minibatches share out by agent.

        Args:
            prepare: steps with the advantages that a critic gives them.
            params: actor and critic before the update.
            networks: that take them.
            normalizer: running statistics.
        """
        del params, networks, normalizer
        return prepare

    def loss(
        self,
        params: Any,
        networks: PPONetworks,
        normalizer: Any,
        batch: Any,
        weights: Weights,
        key: jax.Array,
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """The loss of a minibatch (steps, ...), and what of it is reported."""
        return ppo_loss(params, networks, normalizer, batch, weights, key)


BRAX = Variant()


def variant(name: str) -> Variant:
    """The details of that name.

    Raises:
        ValueError: unknown name.
    """
    return VARIANTS[name].load()
