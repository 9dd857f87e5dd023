"""Collisions of the agents with each other, with parked cars, walls and discs."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_corners
from carpark_mj.geometry.broad_phase import MARGIN
from carpark_mj.types import Motion


def strays(motion: Motion) -> jax.Array:
    """How far (num_agents,) [m] points of the agents' boxes are from where they end."""
    # A rigid motion moves a corner farthest.
    corners = box_corners(motion.trace_w, motion.size[:, None])
    return jnp.linalg.norm(corners - corners[:, -1:], axis=-1).max(axis=(1, 2))


def reaches(motion: Motion) -> jax.Array:
    """Radii (num_agents,) [m] about where agents end that hold all of their traces."""
    way = motion.trace_w[..., :2] - motion.trace_w[:, -1:, :2]
    way = jnp.linalg.norm(way, axis=-1).max(axis=1)
    return jnp.linalg.norm(motion.size, axis=-1) / 2 + way + MARGIN
