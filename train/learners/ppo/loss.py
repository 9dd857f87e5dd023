"""PPO's loss of a minibatch whose advantages are known."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from brax.training.agents.ppo.losses import PPONetworkParams
from brax.training.agents.ppo.networks import PPONetworks
from flax import struct

VALUE_COST = 0.25  # weight of the value's squared error, as in Brax


@struct.dataclass
class Minibatch:
    """Steps (..., size) to learn from, see `Rollout`.

    Attributes:
        observation: what the agents saw.
        raw_action: what they did.
        log_prob: its log-density when it was drawn.
        advantage: of the action.
        target: of the critic.
        weight: see `Rollout`.
    """

    observation: jax.Array
    raw_action: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array
    weight: jax.Array | None = None


@struct.dataclass
class Weights:
    """What of the loss changes during training; () each.

    Attributes:
        entropy_cost: weight of the entropy bonus.
        clip: clipping of the probability ratio.
    """

    entropy_cost: jax.Array
    clip: jax.Array


def weighted_mean(x: jax.Array, weight: jax.Array | None) -> jax.Array:
    """The mean () of numbers (...) with weights (...); None = all 1."""
    if weight is None:
        return x.mean()
    return jnp.sum(weight * x) / jnp.maximum(jnp.sum(weight), 1.0)


def ppo_loss(
    params: PPONetworkParams,
    networks: PPONetworks,
    normalizer: Any,
    batch: Minibatch,
    weights: Weights,
    key: jax.Array,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The clipped loss, and what of it is reported.

    It is that of `brax.training.agents.ppo.losses.compute_ppo_loss`, which computes
    values and advantages of the minibatch itself, for every minibatch.

    Args:
        params: actor and critic.
        networks: that take them.
        normalizer: running statistics of the observations.
        batch: the minibatch; its advantages are normalised here.
        weights: of the terms.
        key: for the entropy, which is sampled.
    """
    distribution: Any = networks.parametric_action_distribution
    logits = networks.policy_network.apply(normalizer, params.policy, batch.observation)
    value = networks.value_network.apply(normalizer, params.value, batch.observation)

    mean = partial(weighted_mean, weight=batch.weight)
    advantage = batch.advantage
    if batch.weight is None:
        spread = advantage.std()
    else:
        spread = jnp.sqrt(mean(jnp.square(advantage - mean(advantage))))
    advantage = (advantage - mean(advantage)) / (spread + 1e-8)
    log_ratio = distribution.log_prob(logits, batch.raw_action) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1.0 - weights.clip, 1.0 + weights.clip)
    policy_loss = -mean(jnp.minimum(ratio * advantage, clipped * advantage))
    v_loss = VALUE_COST * mean(jnp.square(batch.target - value))
    entropy_loss = -weights.entropy_cost * mean(distribution.entropy(logits, key))
    total_loss = policy_loss + v_loss + entropy_loss

    return total_loss, {
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
    return {
        "policy_dist_mean_std": drawn_from.scale.mean(),
        "policy_dist_max_std": drawn_from.scale.max(),
        "policy_dist_min_std": drawn_from.scale.min(),
        "policy_dist_mean_loc": drawn_from.loc.mean(),
        "policy_dist_max_loc": drawn_from.loc.max(),
        "policy_dist_min_loc": drawn_from.loc.min(),
    }
