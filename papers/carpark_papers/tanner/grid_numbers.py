"""Speeds and bearings in the numbers of the grid."""

import jax
import jax.numpy as jnp

from carpark_papers.tanner.grid_config import GridConfig


def speed_level(grid: GridConfig, ctrl_dt: float, speed: jax.Array) -> jax.Array:
    """Speeds [m/s] in levels of the grid, forwards positive."""
    return speed / (grid.speed_step * grid.point_size / ctrl_dt)


def bearing_index(grid: GridConfig, local: jax.Array) -> jax.Array:
    """Bearings of poses (..., 3) in the observer's frame to the nearest heading.

    Returns:
        (...) integers in [0, headings), clockwise from ahead.
    """
    clockwise = -jnp.arctan2(local[..., 1], local[..., 0])
    return jnp.mod(jnp.round(clockwise * grid.headings / (2 * jnp.pi)), grid.headings)
