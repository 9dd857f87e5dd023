"""Rows of cells side by side along an aisle: bays, islands, gaps with pillars.

Rows are made in the frame of their aisle: travel along +x, the row on the left with its
edge at y = 0, entered forwards after a left turn by the parking angle. Mirror images
give the other side and the other direction.
"""

import jax
import jax.numpy as jnp


def cell_poses(
    offset: jax.Array, width: jax.Array, length: jax.Array, angle: jax.Array
) -> jax.Array:
    """Poses (..., 3) of cells whose headings point out into the aisle.

    Args:
        offset: (...) where each cell's near line meets the aisle's edge [m].
        width: (...) of each cell, across its heading [m].
        length: () of the cells [m].
        angle: () between the aisle and the cells [rad], in (0, pi / 2].
    """
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    # The corner at the far line touches the aisle's edge; from there to the centre it
    # is half a width back and half a length in.
    x = offset + width / sin - width / 2 * sin + length / 2 * cos
    y = width / 2 * cos + length / 2 * sin
    x, y, yaw = jnp.broadcast_arrays(x, y, angle + jnp.pi)
    return jnp.stack([x, y, yaw], axis=-1)


def row_depth(width: jax.Array, length: jax.Array, angle: jax.Array) -> jax.Array:
    """Depth [m] of a row of bays, from the aisle's edge to its far corners."""
    return length * jnp.sin(angle) + width * jnp.cos(angle)


def mirror(pose: jax.Array, flip_x: jax.Array, flip_y: jax.Array) -> jax.Array:
    """Mirrors poses (..., 3) of boxes; flips are +1 (as it is) or -1."""
    x, y, yaw = pose[..., 0] * flip_x, pose[..., 1] * flip_y, pose[..., 2]
    yaw = jnp.arctan2(jnp.sin(yaw) * flip_y, jnp.cos(yaw) * flip_x)
    return jnp.stack(jnp.broadcast_arrays(x, y, yaw), axis=-1)
