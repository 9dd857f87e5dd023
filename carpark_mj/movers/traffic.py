"""The drivers of a lot: where they are, the tracks of its lanes, and their paths."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.geometry import move_forward, rotate, wrap_angle
from carpark_mj.layouts.types import Layout
from carpark_mj.vehicle.presets import CITY

BORDER = 3.0  # m from the lot's border: where drivers come in
RING = 1.5  # m, inset of a ring from the border of open ground
SHORTEST = 9.0  # m, of a track on which a driver comes in
# What a driver does.
DRIVE, PARK, STAY, BACK_OUT, AWAY = range(5)
SHARP, OPPOSITE = 0.3, 2.6  # rad, least and largest change of direction
SIZE: Any = np.array([CITY.length, CITY.width], np.float32)
OFFSET = CITY.centre_offset  # m, rear axle to footprint centre
RADIUS = 3.5  # m, of arcs; the tightest of the rear axle is 3.2 m
NOSE = OFFSET + CITY.length / 2 + 0.3  # m, from the rear axle to what is before it


@struct.dataclass
class Path:
    """Paths (...) of rear axles, in the direction of travel."""

    origin: jax.Array  # (..., 2) where they begin [m]
    yaw: jax.Array  # (...) direction of travel there [rad]
    straight: jax.Array  # (...) length of the first line [m]
    bend: jax.Array  # (...) change of direction in the arc, left positive [rad]
    radius: jax.Array  # (...) of the arc [m]
    total: jax.Array  # (...) length [m]
    gear: jax.Array  # (...) 1 forwards, -1 in reverse

    @property
    def arc_end(self) -> jax.Array:
        """(...) way to the end of the arc [m]."""
        return self.straight + self.radius * jnp.abs(self.bend)

    def along(self, xy: jax.Array) -> jax.Array:
        """Ways (...) to points (..., 2) along the first line [m]."""
        x, y = jnp.unstack(xy - self.origin, axis=-1)
        return x * jnp.cos(self.yaw) + y * jnp.sin(self.yaw)

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
    """Paths (...) reversed, in the other gear."""
    end = path.at(path.total[..., None])[..., 0, :2]
    straight = jnp.maximum(path.total - path.arc_end, 0.0)
    yaw = path.yaw + path.bend + jnp.pi
    radius, total, gear = path.radius, path.total, -path.gear
    return Path(end, yaw, straight, -path.bend, radius, total, gear)


class Arcs(NamedTuple):
    """Arcs from a line (3,) into others (k,), not parallel ones."""

    line: jax.Array  # (3,)
    along: jax.Array  # it, to where it crosses the others [m]
    beyond: jax.Array  # along the others, to there [m]
    bend: jax.Array  # change of direction [rad]
    start: jax.Array  # along the line, where arcs begin [m]
    end: jax.Array  # along the others, where they end [m]
    good: jax.Array  # bool, turns neither too little nor too much

    def path(self, index: jax.Array, rest: jax.Array | float, gear: float) -> Path:
        """The path of one of them, and `rest` [m] after it."""
        start, bend, radius = self.start[index], self.bend[index], jnp.float32(RADIUS)
        total = start + RADIUS * jnp.abs(bend) + rest
        begin = self.line[:2], self.line[2], start
        return Path(*begin, bend, radius, total, jnp.float32(gear))


def arcs_into(others: jax.Array, line: jax.Array) -> Arcs:
    """The arcs into lines (k, 3) from another."""
    x, y, yaw = jnp.unstack(line, axis=-1)
    other_x, other_y, other_yaw = jnp.unstack(others, axis=-1)
    bend = other_yaw - yaw
    bend = jnp.arctan2(jnp.sin(bend), jnp.cos(bend))
    sine = jnp.sin(bend)
    sine = jnp.where(jnp.abs(sine) < 1e-3, 1e-3, sine)
    x, y = other_x - x, other_y - y

    def cross(yaw: jax.Array) -> jax.Array:
        return x * jnp.sin(yaw) - y * jnp.cos(yaw)

    along, beyond = cross(other_yaw) / sine, cross(yaw) / sine
    # From the end of an arc to where its tangents cross.
    tangent = RADIUS * jnp.tan(jnp.minimum(jnp.abs(bend), 2.8) / 2.0)
    good = (jnp.abs(bend) > SHARP) & (jnp.abs(bend) < OPPOSITE)
    return Arcs(line, along, beyond, bend, along - tangent, beyond + tangent, good)


@struct.dataclass
class Tracks:
    """Tracks (n,) of a lot."""

    pose: jax.Array  # (n, 3) where they begin, and their directions [m, m, rad]
    length: jax.Array  # (n,) [m]
    mask: jax.Array  # (n,) bool
    entry: jax.Array  # (n,) bool, whether drivers come in where it begins


def make_tracks(layout: Layout) -> Tracks:
    """The tracks of a lot; see `carpark_mj.movers.drivers`."""
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
    pose, length, mask = (jnp.concatenate(row) for row in rows)
    # Tracks that begin at the lot's border are entries; if none does, all are.
    long = mask & (length >= SHORTEST)
    border = long & (jnp.abs(pose[:, :2]) > layout.extent - BORDER).any(axis=-1)
    return Tracks(pose, length, mask, jnp.where(border.any(), border, long))


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


@struct.dataclass
class Traffic:
    """The drivers of a lot, (n,)."""

    pose: jax.Array  # (n, 3) of rear axles
    speed: jax.Array  # in the gear's direction [m/s], at least 0
    steering: jax.Array  # [rad]
    path: Path  # on which they drive
    way: jax.Array  # driven on it [m]
    phase: jax.Array  # int32, what they do
    track: jax.Array  # int32, on which they are
    next_track: jax.Array  # int32, to which the path leads
    bay: jax.Array  # int32, that of the car, or that it heads for; `NO_BAY` = none
    clock: jax.Array  # time of standing [s], since they came to stay or went away
    stay: jax.Array  # time in bays [s]
    aggressiveness: jax.Array  # in [0, 1]
    attentive: jax.Array  # bool, looks before it drives
    turn: jax.Array  # () int32, the driver that plans next
    tracks: Tracks  # of the lot

    @property
    def present(self) -> jax.Array:
        """(n,) bool, is in the lot."""
        return self.phase != AWAY

    @property
    def centre(self) -> jax.Array:
        """(n, 3) poses of footprints."""
        return move_forward(self.pose, OFFSET)

    @property
    def velocity(self) -> jax.Array:
        """(n, 2) of rear axles [m/s]."""
        along = self.speed * self.path.gear
        yaw = self.pose[:, 2]
        return jnp.stack([along * jnp.cos(yaw), along * jnp.sin(yaw)], axis=-1)


def track_path(tracks: Tracks, track: jax.Array) -> Path:
    """Paths (n,) along tracks to their ends, forwards."""
    pose, total = tracks.pose[track], jnp.maximum(tracks.length[track] - NOSE, 0.1)
    one, nothing = jnp.ones_like(total), jnp.zeros_like(total)
    radius = jnp.full_like(total, RADIUS)
    return Path(pose[..., :2], pose[..., 2], total, nothing, radius, total, one)
