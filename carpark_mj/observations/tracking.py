"""Tracked cars: the nearest to each agent."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import nearest
from carpark_mj.types import ParkedCars


def track_agents(
    count: int,
    pose: jax.Array,
    present: jax.Array | None = None,
    num_observers: int | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The nearest other agents.

    Args:
        count: how many.
        pose: (num_agents, 3).
        present: (num_agents,) bool, see `State.present`.
        num_observers: how many of them track, the first; None = all.

    Returns:
        Indices and presence (num_observers, count), see `geometry.nearest`.
    """
    xy, others = pose[:, :2], other_agents(pose.shape[0], present)
    return nearest(xy[:num_observers], xy, others[:num_observers], count)


def track_parked_cars(
    count: int, own_pose: jax.Array, parked_cars: ParkedCars
) -> tuple[jax.Array, jax.Array]:
    """The nearest parked cars.

    Args:
        count: how many.
        own_pose: (num_agents, 3) observers.
        parked_cars: (num_parked_cars,) of the lot.

    Returns:
        Indices and presence (num_agents, count), see `geometry.nearest`.
    """
    xy, present = parked_cars.pose_w[:, :2], parked_cars.present
    mask = jnp.broadcast_to(present, (own_pose.shape[0], *present.shape))
    return nearest(own_pose[:, :2], xy, mask, count)


def other_agents(count: int, present: jax.Array | None) -> jax.Array:
    """(count, count) bool, [i, j] whether j is another agent and present."""
    others = ~jnp.eye(count, dtype=bool)
    return others if present is None else others & present


def mark(index: jax.Array, present: jax.Array, count: int) -> jax.Array:
    """Marks those tracked.

    Args:
        index: (num_agents, k) of them.
        present: (num_agents, k) whether there are such.
        count: of all that can be tracked.

    Returns:
        (num_agents, count) bool.
    """
    same = index[..., None] == jnp.arange(count)
    return jnp.any(same & present[..., None], axis=1)
