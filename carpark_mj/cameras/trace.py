"""Rays from a camera to upright boxes and cylinders."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.cameras.blocks import Blocks
from carpark_mj.cameras.hits import MISS, SHADES, encode, fold
from carpark_mj.cameras.rig import Seen
from carpark_mj.geometry.se2 import rotate

SUN = (-0.34, -0.24, 0.91)  # unit vector to it, as in MuJoCo's scene
AMBIENT, DIFFUSE = 0.45, 0.55
_LEAST = 1e-9  # slope of a ray along a face


@struct.dataclass
class Seat:
    """Blocks (n,) as the camera of one car sees them.

    Attributes:
        eye: (n, 3) of the camera in the frame of the block, from its middle on the
            ground [m].
        cos: (n,) of the block's heading less the car's.
        sin: (n,) of the same.
        half: (n, 2) half length and half width [m], negative where there is none.
        span: (n, 2) heights of its underside and its top [m].
        seen: (n,) int32 what it is.
        light: (n, 2) from the left and ahead of the block, the sun's share of the
            direction of its length and its width.
    """

    eye: jax.Array
    cos: jax.Array
    sin: jax.Array
    half: jax.Array
    span: jax.Array
    seen: jax.Array
    light: jax.Array


def seat(blocks: Blocks, agent: jax.Array, pose_w: jax.Array, eye: jax.Array) -> Seat:
    """Blocks as one camera sees them.

    Args:
        blocks: of the lot.
        agent: () int32 whose camera it is.
        pose_w: (3,) of the car.
        eye: (3,) of the camera in the car's frame, from its middle on the ground [m].
    """
    yaw = blocks.pose_w[:, 2]
    turn = yaw - pose_w[2]
    eye_w = pose_w[:2] + rotate(eye[:2], pose_w[2])
    own = blocks.owner == agent
    there = rotate(eye_w - blocks.pose_w[:, :2], -yaw)
    up = jnp.broadcast_to(eye[2], (*yaw.shape, 1))
    return Seat(
        eye=jnp.concatenate([there, up], axis=1),
        cos=jnp.cos(turn),
        sin=jnp.sin(turn),
        half=blocks.half,
        span=jnp.stack([blocks.low, blocks.high], axis=1),
        seen=jnp.where(own, Seen.OWN_CAR, blocks.seen),
        light=rotate(jnp.array(SUN[:2]), -yaw),
    )


def trace(
    hit: jax.Array, rays: jax.Array, boxes: Seat, cylinders: Seat, shaded: bool
) -> jax.Array:
    """Hits (...) int32 of rays, of what is nearer than the hits so far.

    Args:
        hit: so far (...).
        rays: (..., 3) unit vectors in the car's frame.
        boxes: what they can meet.
        cylinders: the same.
        shaded: whether hits tell their shades.
    """
    slopes = [_off_zero(rays[..., k]) for k in range(3)]

    def nearest(
        hit: jax.Array, blocks: Seat, meet: Callable[..., jax.Array]
    ) -> jax.Array:
        if not blocks.cos.shape[0]:
            return hit
        nothing = jax.tree.map(lambda x: jnp.full_like(x[0], -1), blocks)
        return fold(
            hit, blocks, nothing, lambda h, b: jnp.minimum(h, meet(slopes, b, shaded))
        )

    return nearest(nearest(hit, boxes, _meet_box), cylinders, _meet_cylinder)


def _off_zero(slope: jax.Array) -> jax.Array:
    return jnp.where(jnp.abs(slope) < _LEAST, _LEAST, slope)


def _slab(start: jax.Array, half: jax.Array, slope: jax.Array):
    """Where a ray enters and leaves a slab about 0."""
    inverse = 1.0 / slope
    middle, reach = -start * inverse, half * jnp.abs(inverse)
    return middle - reach, middle + reach


def _storey(rays: list[jax.Array], block: Seat):
    """Where rays enter and leave the heights of a block."""
    half = (block.span[1] - block.span[0]) / 2
    return _slab(block.eye[2] - block.span[0] - half, half, rays[2])


def _meet_box(rays: list[jax.Array], box: Seat, shaded: bool) -> jax.Array:
    """Hits of rays with the outside of a box."""
    dx = _off_zero(box.cos * rays[0] + box.sin * rays[1])
    dy = _off_zero(box.cos * rays[1] - box.sin * rays[0])
    enter_x, leave_x = _slab(box.eye[0], box.half[0], dx)
    enter_y, leave_y = _slab(box.eye[1], box.half[1], dy)
    enter_z, leave_z = _storey(rays, box)
    enter = jnp.maximum(jnp.maximum(enter_x, enter_y), enter_z)
    leave = jnp.minimum(jnp.minimum(leave_x, leave_y), leave_z)
    if not shaded:
        return _hit(enter, leave, box)
    aside = jnp.where(
        enter == enter_x, -jnp.sign(dx) * box.light[0], -jnp.sign(dy) * box.light[1]
    )
    light = jnp.where(enter == enter_z, -jnp.sign(rays[2]) * SUN[2], aside)
    return _hit(enter, leave, box, light)


def _meet_cylinder(rays: list[jax.Array], cylinder: Seat, shaded: bool) -> jax.Array:
    """Hits of rays with the outside of an upright cylinder."""
    dx = cylinder.cos * rays[0] + cylinder.sin * rays[1]
    dy = cylinder.cos * rays[1] - cylinder.sin * rays[0]
    x, y, radius = cylinder.eye[0], cylinder.eye[1], cylinder.half[0]
    flat = 1.0 / (dx * dx + dy * dy)
    nearest, aside = -(x * dx + y * dy) * flat, x * dy - y * dx
    # From the chord, not from the quadratic formula, which cancels far away.
    chord = jnp.sqrt(jnp.maximum(radius**2 - aside * aside * flat, 0.0) * flat)
    missed = aside * aside * flat >= radius * jnp.abs(radius)
    enter_z, leave_z = _storey(rays, cylinder)
    enter = jnp.maximum(nearest - chord, enter_z)
    leave = jnp.where(missed, -1.0, jnp.minimum(nearest + chord, leave_z))
    if not shaded:
        return _hit(enter, leave, cylinder)
    at_x, at_y = x + enter * dx, y + enter * dy
    aside = (at_x * cylinder.light[0] + at_y * cylinder.light[1]) / radius
    light = jnp.where(enter == enter_z, -jnp.sign(rays[2]) * SUN[2], aside)
    return _hit(enter, leave, cylinder, light)


def _hit(
    enter: jax.Array, leave: jax.Array, block: Seat, light: jax.Array | None = None
) -> jax.Array:
    """Hits of what a ray enters; from inside it sees nothing of a block."""
    shade = SHADES
    if light is not None:
        level = AMBIENT + DIFFUSE * jnp.maximum(light, 0.0)
        shade = jnp.round(SHADES * level).astype(jnp.int32)
    met = (enter <= leave) & (enter > 0.0)
    return jnp.where(met, encode(enter, block.seen, shade), MISS)
