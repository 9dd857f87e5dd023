"""Paths of drivers: a straight line, an arc and another straight line."""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import rotate


@struct.dataclass
class Path:
    """Paths (...) of rear axles, in the direction of travel.

    Attributes:
        origin: (..., 2) where they begin [m].
        yaw: (...) direction of travel there [rad].
        straight: (...) length of the first line [m].
        bend: (...) change of direction in the arc, left positive [rad].
        radius: (...) of the arc [m].
        total: (...) length [m].
        gear: (...) 1 forwards, -1 in reverse.
    """

    origin: jax.Array
    yaw: jax.Array
    straight: jax.Array
    bend: jax.Array
    radius: jax.Array
    total: jax.Array
    gear: jax.Array

    @property
    def arc_end(self) -> jax.Array:
        """(...) way to the end of the arc [m]."""
        return self.straight + self.radius * jnp.abs(self.bend)

    def at(self, way: jax.Array) -> jax.Array:
        """Poses (..., k, 3) of the car's rear axle after ways (..., k) [m]."""
        straight, bend, radius, yaw, gear = (
            value[..., None]
            for value in (self.straight, self.bend, self.radius, self.yaw, self.gear)
        )
        line = jnp.minimum(way, straight)
        turned = jnp.clip((way - straight) / radius, 0.0, jnp.abs(bend))
        rest = jnp.maximum(way - straight - radius * jnp.abs(bend), 0.0)
        side = jnp.sign(bend)
        x = line + radius * jnp.sin(turned) + rest * jnp.cos(bend)
        y = side * radius * (1.0 - jnp.cos(turned)) + rest * jnp.sin(bend)
        xy = self.origin[..., None, :] + rotate(jnp.stack([x, y], axis=-1), yaw)
        heading = yaw + side * turned + jnp.where(gear < 0.0, jnp.pi, 0.0)
        return jnp.concatenate([xy, heading[..., None]], axis=-1)


def turn_back(path: Path) -> Path:
    """The same paths (...) from their ends to their beginnings, in the other gear."""
    end = path.at(path.total[..., None])[..., 0, :2]
    straight = jnp.maximum(path.total - path.arc_end, 0.0)
    yaw = path.yaw + path.bend + jnp.pi
    radius, total, gear = path.radius, path.total, -path.gear
    return Path(end, yaw, straight, -path.bend, radius, total, gear)


def straight_path(pose: jax.Array, total: jax.Array, radius: jax.Array) -> Path:
    """Straight paths from poses (..., 3), forwards; `radius` of later arcs."""
    one, nothing = jnp.ones_like(total), jnp.zeros_like(total)
    radius = jnp.broadcast_to(radius, total.shape)
    return Path(pose[..., :2], pose[..., 2], total, nothing, radius, total, one)


def crossing(
    pose: jax.Array, other: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Where lines (..., 3) cross others (..., 3).

    Returns:
        Ways (...) along the first and along the second line [m], and the change of
        direction [rad]; ways are meaningless where lines are parallel.
    """
    bend = other[..., 2] - pose[..., 2]
    bend = jnp.arctan2(jnp.sin(bend), jnp.cos(bend))
    sine = jnp.where(jnp.abs(jnp.sin(bend)) < 1e-3, 1e-3, jnp.sin(bend))
    delta = other[..., :2] - pose[..., :2]

    def cross(yaw: jax.Array) -> jax.Array:
        return delta[..., 0] * jnp.sin(yaw) - delta[..., 1] * jnp.cos(yaw)

    return cross(other[..., 2]) / sine, cross(pose[..., 2]) / sine, bend


def tangent(bend: jax.Array, radius: jax.Array) -> jax.Array:
    """Way (...) [m] from the end of an arc to where its tangents cross."""
    return radius * jnp.tan(jnp.minimum(jnp.abs(bend), 2.8) / 2.0)
