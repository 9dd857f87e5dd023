"""Advantages of a rollout's actions and targets of the critic."""

from typing import Any

import jax
from brax.training.agents.ppo.losses import compute_gae

from carpark_mj.training.ppo.collect import Rollout


def compute_advantages(
    rollout: Rollout,
    values: jax.Array,
    final_value: jax.Array,
    discount: Any,
    gae_lambda: float,
) -> tuple[jax.Array, jax.Array]:
    """Generalised advantage estimation, Brax's.

    Targets are those of lambda. Advantages are of the reward and the next step's target
    above the value, so that lambda only damps what comes after the next step.

    Those of truncated steps mean nothing, for what comes after is not known: as in Brax
    the advantage is 0 and the target the critic's own value. No loss counts them.

    Args:
        rollout: of the agents.
        values: (time, agents) of the rollout's observations.
        final_value: (agents,) of the observation after the last step.
        discount: () discount factor per control step.
        gae_lambda: lambda.

    Returns:
        Advantages and value targets (time, agents), without gradients.
    """
    targets, advantages = compute_gae(
        truncation=rollout.truncated,
        termination=rollout.terminated,
        rewards=rollout.reward,
        values=values,
        bootstrap_value=final_value,
        lambda_=gae_lambda,
        discount=discount,
    )
    return advantages, targets
