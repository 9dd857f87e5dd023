"""Rewards: progress along the route, and events.

A metre of progress earns 1, paid once more than 0.5 m have added up since the last
payment. Leaving the road or the route, driving on the shoulder or the wrong way, or a
crash costs 10 (once in a step), the goal earns 10.
"""

import jax
import jax.numpy as jnp

from carpark_papers.cederle.junction.config import RewardRules
from carpark_papers.cederle.junction.types import Events

LEAST_PROGRESS = 0.5  # m
EVENT = 10.0


def pay_progress(unpaid: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rewards for progress (num_agents,) [m] since the last payments.

    Returns:
        Rewards, and the progress that stays unpaid.
    """
    due = unpaid > LEAST_PROGRESS
    return jnp.where(due, unpaid, 0.0), jnp.where(due, 0.0, unpaid)


def reward(rules: RewardRules, progress: jax.Array, events: Events) -> jax.Array:
    """Rewards (num_agents,) of a step.

    Args:
        rules: which reading of the study.
        progress: (num_agents,) rewards for progress.
        events: of the step.
    """
    failed = events.off_road | events.on_shoulder | events.wrong_way
    failed = failed | events.crashed | events.off_route
    cost = jnp.where(failed, -EVENT, 0.0)
    gain = jnp.where(events.arrived, EVENT, 0.0)
    if rules.events == "added":
        earned = progress + cost + gain
    else:  # the goal comes last of the events
        earned = jnp.where(failed, cost, jnp.where(events.arrived, gain, progress))
    if rules.joint:
        earned = jnp.broadcast_to(earned.sum(), earned.shape)
    return earned
