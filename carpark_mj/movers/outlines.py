"""Outlines of boxes with their sines, computed once: people look at many of them."""

import jax
import jax.numpy as jnp

AWAY = 1e6  # m, where boxes are that do not count


def outlines(pose: jax.Array, size: jax.Array, mask: jax.Array) -> jax.Array:
    """Boxes (n, 3), (n, 2), (n,) as x, y, cos, sin, half length and half width."""
    xy = jnp.where(mask[:, None], pose[:, :2], AWAY)
    yaw = pose[:, 2:]
    return jnp.concatenate([xy, jnp.cos(yaw), jnp.sin(yaw), size / 2], axis=-1)


def offsets(xy: jax.Array, boxes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """X and y [m] from the nearest points of boxes (..., 6) to points (..., 2).

    In the boxes' frames; 0 inside.
    """
    x, y, cos, sin, half_x, half_y = jnp.moveaxis(boxes, -1, 0)
    x, y = xy[..., 0] - x, xy[..., 1] - y
    x, y = cos * x + sin * y, cos * y - sin * x
    return x - jnp.clip(x, -half_x, half_x), y - jnp.clip(y, -half_y, half_y)


def meet(start: jax.Array, end: jax.Array, boxes: jax.Array) -> jax.Array:
    """Whether ways between points (n, 2) meet any of the boxes (m, 6), (n,) bool."""
    x, y, cos, sin, half_x, half_y = jnp.moveaxis(boxes, -1, 0)

    def slab(along: jax.Array, across: jax.Array, half: jax.Array):
        here = along * (start[:, :1] - x) + across * (start[:, 1:] - y)
        way = along * (end - start)[:, :1] + across * (end - start)[:, 1:]
        way = jnp.where(jnp.abs(way) < 1e-6, 1e-6, way)
        one, other = (-half - here) / way, (half - here) / way
        return jnp.minimum(one, other), jnp.maximum(one, other)

    (enter_x, leave_x), (enter_y, leave_y) = (
        slab(cos, sin, half_x),
        slab(-sin, cos, half_y),
    )
    enter, leave = jnp.maximum(enter_x, enter_y), jnp.minimum(leave_x, leave_y)
    return ((enter < leave) & (enter < 1.0) & (leave > 0.0)).any(axis=1)
