"""The loss of a minibatch, and details in which implementations of PPO differ.

Devices that average their gradients learn as one that holds all their steps: means of a
loss and moments of advantages are over the steps of all devices that count.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.policy.brax import PPONetworkParams, PPONetworks

if TYPE_CHECKING:
    from carpark_mj.training.ppo.config import PPOConfig

AXIS = "lots"  # of the mesh of devices
VALUE_COST = 0.25  # weight of the value's squared error, as in Brax


@struct.dataclass
class Minibatch:
    """Steps (..., size) to learn from, see `Rollout`."""

    observation: jax.Array
    raw_action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array  # of the action
    target: jax.Array  # of the critic
    weight: jax.Array  # 0.0 of steps of absent agents and truncated ones, else 1.0
    advice: jax.Array | None = None  # what a teacher would have done


@struct.dataclass
class Weights:
    """What of the loss changes during training; () each."""

    entropy_cost: jax.Array  # weight of the entropy bonus
    clip: jax.Array  # clipping of the probability ratio
    teacher_cost: jax.Array | None = None  # weight of the distance to a teacher


def balance(weight: jax.Array) -> jax.Array:
    """Weights (...) scaled to sum to 1, averaged over the devices; all 0 stay so.

    The average over the devices of what is summed with them is a mean over all steps.
    """
    total = jax.lax.pmean(jnp.sum(weight), AXIS)
    return weight / jnp.maximum(total, 1e-6)


def standardize(advantage: jax.Array, weight: jax.Array, floor: float) -> jax.Array:
    """Advantages (...) less their mean, over their deviation, both of all devices.

    `weight` (...) is of `balance`; `floor` is added to the standard deviation.
    """
    centred = advantage - jax.lax.pmean(jnp.sum(weight * advantage), AXIS)
    variance = jax.lax.pmean(jnp.sum(weight * jnp.square(centred)), AXIS)
    return centred / (jnp.sqrt(variance) + floor)


def ppo_loss(
    params: PPONetworkParams,
    networks: PPONetworks,
    normalizer: Any,
    batch: Minibatch,
    weights: Weights,
    key: jax.Array,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The clipped loss and its reported parts, to be averaged over the devices.

    It is that of `brax.training.agents.ppo.losses.compute_ppo_loss` but where steps are
    truncated, which Brax counts with an advantage of 0 before it normalises, and over
    several devices, which normalise and average in Brax each for itself.

    Args:
        params: actor and critic.
        networks: that take them.
        normalizer: running statistics of the observations.
        batch: this device's part of the minibatch; its advantages are normalised here.
        weights: weights of the terms.
        key: for the entropy, which is sampled.
    """
    distribution: Any = networks.parametric_action_distribution
    logits = networks.policy_network.apply(normalizer, params.policy, batch.observation)
    value = networks.value_network.apply(normalizer, params.value, batch.observation)

    weight = balance(batch.weight)
    advantage = standardize(batch.advantage, weight, floor=1e-8)

    def mean(x: jax.Array) -> jax.Array:
        return jnp.sum(weight * x)

    log_ratio = distribution.log_prob(logits, batch.raw_action) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1.0 - weights.clip, 1.0 + weights.clip)
    policy_loss = -mean(jnp.minimum(ratio * advantage, clipped * advantage))
    v_loss = VALUE_COST * mean(jnp.square(batch.target - value))
    entropy_loss = -weights.entropy_cost * mean(distribution.entropy(logits, key))
    total_loss = policy_loss + v_loss + entropy_loss
    reported = {}
    if batch.advice is not None and weights.teacher_cost is not None:
        apart = jnp.square(distribution.mode(logits) - batch.advice).sum(axis=-1)
        reported["teacher_distance"] = mean(apart)
        total_loss += weights.teacher_cost * reported["teacher_distance"]

    return total_loss, reported | {
        "total_loss": total_loss,
        "policy_loss": policy_loss,
        "v_loss": v_loss,
        "entropy_loss": entropy_loss,
        # The estimate of KL(old || new) of least variance, http://joschu.net/blog/kl-approx.html
        "kl_mean": mean(ratio - 1.0 - log_ratio),
        **describe_policy(distribution.create_dist(logits)),
    }


def describe_policy(drawn_from: Any) -> dict[str, jax.Array]:
    """Spread and location of the distribution that actions are drawn from."""
    numbers = {"std": drawn_from.scale, "loc": drawn_from.loc}
    return {
        f"policy_dist_{statistic}_{name}": getattr(x, statistic)()
        for name, x in numbers.items()
        for statistic in ("mean", "max", "min")
    }


# Steps (time, agents, ...) to learn from, given actor and critic.
Prepare = Callable[[Any], Any]


class Variant:
    """Details of an update; these are Brax's.

    Attributes:
        normalizes: whether observations are normalised by their running statistics.
    """

    normalizes = True

    def check(self, config: "PPOConfig") -> None:
        """Refuses settings that the details are not made for."""

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
        """The loss of a minibatch (steps, ...) and its reported parts."""
        return ppo_loss(params, networks, normalizer, batch, weights, key)


BRAX = Variant()
