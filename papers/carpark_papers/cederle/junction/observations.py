"""The vector observation, un-normalised.

In this order, human-driven cars among the others: position less the goal's (2) [m],
distance to the goal (1) [m], position less that of every other car (2 each) [m],
distances to these (1 each) [m], speed (1) [m/s], steering angle (1) [rad], direction of
the heading (2), way driven (1) [m]: 11 numbers among 2 cars, 14 among 3, 17 among 4.
Axes are the world's. A car that has left is `FAR` away along both axes.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_papers.cederle.junction.types import State

FAR = 100.0  # m


def vector_size(num_cars: int) -> int:
    """Numbers that an agent observes among `num_cars` cars."""
    return 5 + 3 * num_cars


def observe(state: State) -> jax.Array:
    """Vectors (num_agents, vector_size)."""
    motion, n = state.motion, state.active.shape[0]
    cars = motion.xy.shape[0]
    # Row k: the indices of all cars but k.
    others = jnp.arange(cars - 1) + (jnp.arange(cars - 1) >= jnp.arange(n)[:, None])
    xy: jax.Array = motion.xy[:n]
    apart = xy[:, None] - motion.xy[others]
    apart = jnp.where(state.present[others][..., None], apart, FAR)
    to_goal = xy - state.task.goal_xy
    yaw = motion.pose_w[:n, 2]
    parts = (
        to_goal,
        norm(to_goal)[:, None],
        apart.reshape(n, -1),
        norm(apart),
        motion.speed[:n, None],
        motion.steering[:n, None],
        jnp.cos(yaw)[:, None],
        jnp.sin(yaw)[:, None],
        (state.along - state.task.start)[:n, None],
    )
    return jnp.concatenate(parts, axis=-1)
