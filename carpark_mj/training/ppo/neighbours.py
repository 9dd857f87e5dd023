"""Shares of the neighbours' advantages: agents that learn to drive for each other.

Advantages and not rewards: an agent that parks would lose its neighbours' rewards, and
learn to stay. Advantages are 0 on average, wherever it is.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.types import State

# m between centres; measured with it in docs/ablations.md, no other was tried.
RANGE = 15.0


def neighbours(lots: State) -> jax.Array:
    """(lots * agents, agents) bool, which agents of its lot are near each agent.

    Nobody is near itself, or an absent one.

    Args:
        lots: (lots, ...).
    """
    xy, present = lots.motion.xy, lots.active
    num_agents = xy.shape[1]
    near = norm(xy[:, :, None] - xy[:, None]) <= RANGE
    near &= present[:, :, None] & present[:, None] & ~jnp.eye(num_agents, dtype=bool)
    return near.reshape(-1, num_agents)


def neighbours_mean(near: jax.Array, values: jax.Array) -> jax.Array:
    """Mean (time, lots * agents) of the neighbours' values; 0 where there is none.

    Args:
        near: (time, lots * agents, agents), see `neighbours`.
        values: (time, lots * agents).
    """
    num_agents = near.shape[-1]
    lots = values.reshape(len(values), -1, 1, num_agents)
    theirs = jnp.where(near.reshape(*lots.shape[:2], -1, num_agents), lots, 0.0)
    total = theirs.sum(axis=-1).reshape(values.shape)
    return total / jnp.maximum(near.sum(axis=-1), 1)
