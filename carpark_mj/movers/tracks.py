"""Tracks: the directed middle lines on which drivers go."""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import move_forward, rotate, wrap_angle
from carpark_mj.layouts.types import Layout

BORDER = 3.0  # m from the lot's border: where drivers come in
RING = 1.5  # m, inset of a ring from the border of open ground
SHORTEST = 9.0  # m, of a track on which a driver comes in


@struct.dataclass
class Tracks:
    """Tracks (n,) of a lot.

    Attributes:
        pose: (n, 3) where they begin, and their directions [m, m, rad].
        length: (n,) [m].
        mask: (n,) bool.
        entry: (n,) bool, whether drivers come in where it begins.
    """

    pose: jax.Array
    length: jax.Array
    mask: jax.Array
    entry: jax.Array


def make_tracks(layout: Layout) -> Tracks:
    """The tracks of a lot.

    A one-way lane has one, its middle. Others have one in each direction, in the
    middle of the right half. Lots without lanes have a ring inside the first spawn
    region, counter-clockwise.
    """
    pose, size, mask = layout.lane_pose, layout.lane_size, layout.lane_mask
    both = ~layout.lane_one_way
    aside = jnp.where(both, size[:, 1] / 4, 0.0)
    right = rotate(jnp.stack([jnp.zeros_like(aside), -aside], axis=-1), pose[:, 2])
    ahead = jnp.concatenate([pose[:, :2] + right, pose[:, 2:]], axis=-1)
    back = jnp.concatenate(
        [pose[:, :2] - right, wrap_angle(pose[:, 2:] + jnp.pi)], axis=-1
    )
    pose = move_forward(jnp.concatenate([ahead, back]), -jnp.tile(size[:, 0], 2) / 2)
    of_lanes = pose, jnp.tile(size[:, 0], 2), jnp.concatenate([mask, mask & both])
    rows = zip(of_lanes, _ring(layout), strict=True)
    return _entries(layout, *(jnp.concatenate(row) for row in rows))


def _ring(layout: Layout) -> tuple[jax.Array, jax.Array, jax.Array]:
    centre, size = layout.spawn_pose[0], layout.spawn_size[0]
    half = jnp.maximum(size / 2 - RING, 0.1)
    corner = half * jnp.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    xy = centre[:2] + rotate(corner, centre[2])
    yaw = wrap_angle(centre[2] + jnp.arange(4) * jnp.pi / 2)
    length = 2.0 * jnp.tile(half, 2)
    has_ring = layout.spawn_mask[0] & ~layout.lane_mask.any()
    mask = jnp.broadcast_to(has_ring, (4,))
    return jnp.concatenate([xy, yaw[:, None]], axis=-1), length, mask


def _entries(
    layout: Layout, pose: jax.Array, length: jax.Array, mask: jax.Array
) -> Tracks:
    """Tracks that begin at the lot's border are entries; if none does, all are."""
    long = mask & (length >= SHORTEST)
    border = long & (jnp.abs(pose[:, :2]) > layout.extent - BORDER).any(axis=-1)
    return Tracks(pose, length, mask, jnp.where(border.any(), border, long))
