"""Outlines of boxes with their sines, computed once: people look at many of them."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.geometry.obstacles import Discs, Group

AWAY = 1e6  # m, where boxes are that do not count


def outlines(pose: jax.Array, size: jax.Array, mask: jax.Array) -> jax.Array:
    """Boxes (n, 3), (n, 2), (n,) as (6, n).

    X, y, cos, sin, half length and half width; each of them lies in one row, as loops
    over boxes want it.
    """
    x, y, yaw = pose.T
    half_x, half_y = size.T / 2
    x, y = jnp.where(mask, x, AWAY), jnp.where(mask, y, AWAY)
    return jnp.stack([x, y, jnp.cos(yaw), jnp.sin(yaw), half_x, half_y])


def group_outlines(groups: Sequence[Group]) -> jax.Array:
    """Outlines (6, n) of groups, of discs as squares."""
    rows = [jnp.zeros((6, 0))]
    for group in groups:
        pose, size = group.pose_w, group.size
        if isinstance(group, Discs):
            pose = jnp.pad(pose, ((0, 0), (0, 1)))
            size = jnp.repeat(2.0 * size[:, None], 2, axis=1)
        there = jnp.ones(group.count, bool) if group.mask is None else group.mask
        rows.append(outlines(pose, size, there))
    return jnp.concatenate(rows, axis=1)


def offsets(xy: jax.Array, boxes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """X and y [m] from the nearest points of boxes (6, ...) to points (..., 2).

    In the boxes' frames; 0 inside.
    """
    x, y, cos, sin, half_x, half_y = boxes
    x, y = xy[..., 0] - x, xy[..., 1] - y
    x, y = cos * x + sin * y, cos * y - sin * x
    return x - jnp.clip(x, -half_x, half_x), y - jnp.clip(y, -half_y, half_y)


def meet(start: jax.Array, end: jax.Array, boxes: jax.Array) -> jax.Array:
    """Whether ways between points (n, 2) meet any of the boxes (6, m), (n,) bool."""
    x, y, cos, sin, half_x, half_y = boxes

    def turn(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        return cos * x + sin * y, cos * y - sin * x

    # Separating axes, by half the way and its middle: no quotients.
    middle, half = (start + end) / 2, (end - start) / 2
    x, y = turn(middle[:, :1] - x, middle[:, 1:] - y)
    way_x, way_y = turn(half[:, :1], half[:, 1:])
    long, wide = jnp.abs(way_x), jnp.abs(way_y)
    meets = (jnp.abs(x) < half_x + long) & (jnp.abs(y) < half_y + wide)
    across = jnp.abs(way_x * y - way_y * x) <= half_x * wide + half_y * long
    return (meets & across).any(axis=1)


def columns(x: jax.Array, y: jax.Array) -> jax.Array:
    """Vectors (n, 2) of x and y (n,): a stack that XLA computes once on a CPU.

    Into one by `jnp.stack` it would fuse all that x and y are made of, which hinders
    vectorisation.
    """
    return jnp.where(jnp.arange(2) == 0, x[:, None], y[:, None])
