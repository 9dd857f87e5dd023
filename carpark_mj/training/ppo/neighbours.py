"""Shares of the neighbours' rewards: agents that learn to drive for each other."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.types import State

# m between centres; measured with it in docs/ablations.md, no other was tried.
RANGE = 15.0


def neighbours_mean(lots: State, reward: jax.Array) -> jax.Array:
    """Mean reward (lots * agents,) of the other agents nearby; 0 where there is none.

    Args:
        lots: (lots, ...) before the step, when those count that are present.
        reward: (lots * agents,) of the step.
    """
    xy, present = lots.motion.xy, lots.active
    num_agents = xy.shape[1]
    apart = norm(xy[:, :, None] - xy[:, None])
    near = (apart <= RANGE) & ~jnp.eye(num_agents, dtype=bool)
    near &= present[:, :, None] & present[:, None]
    theirs = jnp.where(near, reward.reshape(-1, 1, num_agents), 0.0).sum(axis=-1)
    return (theirs / jnp.maximum(near.sum(axis=-1), 1)).reshape(-1)
