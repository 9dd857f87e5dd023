"""Actor and critic: Brax's PPO networks, sized by a frozen config."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
from brax.training import networks as brax_networks
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks as ppo_networks
from flax import linen
from jax.tree_util import Partial

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.distributions import action_distribution

Policy = Callable[[jax.Array, jax.Array], tuple[jax.Array, dict[str, Any]]]

# Smallest standard deviation by which observations (scaled to about 1) are divided:
# what hardly varied in training (sizes in a lot of equal bays) must not swamp the
# network where it differs.
MIN_STD = 0.1


@dataclasses.dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the networks; activations are swish.

    Attributes:
        policy_layers: sizes of the actor's hidden layers.
        value_layers: sizes of the critic's hidden layers.
    """

    policy_layers: tuple[int, ...] = (128, 128)
    value_layers: tuple[int, ...] = (128, 128)

    def __post_init__(self) -> None:
        for name in ("policy_layers", "value_layers"):
            if any(size < 1 for size in getattr(self, name)):
                raise ValueError(
                    f"{name} must be positive sizes, not {getattr(self, name)}"
                )


def make_networks(
    config: NetworkConfig, observation_size: int, action: ActionSpec
) -> ppo_networks.PPONetworks:
    """Builds actor and critic over normalised observations.

    Like `ppo_networks.make_ppo_networks`, which has no categorical distribution.
    """
    normalize: Any = running_statistics.normalize  # wider than Brax asks for
    distribution = action_distribution(action)
    networks: Any = ppo_networks.PPONetworks  # its fields are hidden from Pyright
    return networks(
        policy_network=brax_networks.make_policy_network(
            distribution.param_size,
            observation_size,
            preprocess_observations_fn=normalize,
            hidden_layer_sizes=config.policy_layers,
            activation=linen.swish,
        ),
        value_network=brax_networks.make_value_network(
            observation_size,
            preprocess_observations_fn=normalize,
            hidden_layer_sizes=config.value_layers,
            activation=linen.swish,
        ),
        parametric_action_distribution=distribution,
    )


def make_policy(
    networks: ppo_networks.PPONetworks,
    normalizer: Any,
    policy_params: Any,
    deterministic: bool,
) -> Policy:
    """An acting function `(observation, key) -> (action, extras)`."""
    make: Any = ppo_networks.make_inference_fn(networks)

    def act(params: Any, observation: jax.Array, key: jax.Array) -> Any:
        return make(params, deterministic=deterministic)(observation, key)

    return Partial(act, (normalizer, policy_params))


def as_argument(policy: Policy) -> Policy:
    """A policy as a pytree of its parameters, to be passed to a jitted function.

    If the function closed over it, its weights would be constants of the program, which
    would be compiled again for every checkpoint.
    """
    return policy if isinstance(policy, Partial) else Partial(policy)
