"""The drivers of a lot: where they are and what they are about to do."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.geometry import move_forward
from carpark_mj.movers.paths import Path, straight_path
from carpark_mj.movers.tracks import Tracks
from carpark_mj.vehicle.presets import CITY

Tree = TypeVar("Tree")

# What a driver does.
DRIVE, PARK, STAY, BACK_OUT, AWAY = range(5)
SIZE: Any = np.array([CITY.length, CITY.width], np.float32)
OFFSET = CITY.centre_offset  # m, rear axle to footprint centre
RADIUS = 3.5  # m, of arcs; the tightest of the rear axle is 3.2 m
NOSE = OFFSET + CITY.length / 2 + 0.3  # m, from the rear axle to what is before it


@struct.dataclass
class Traffic:
    """The drivers of a lot, (n,).

    Attributes:
        pose: (n, 3) of rear axles.
        speed: in the gear's direction [m/s], at least 0.
        steering: [rad].
        path: on which they drive.
        way: driven on it [m].
        phase: int32, what they do.
        track: int32, on which they are.
        next_track: int32, to which the path leads.
        bay: int32, that of the car, or that it heads for; `NO_BAY` = none.
        clock: time of standing [s], since they came to stay or went away.
        stay: time in bays [s].
        aggressiveness: in [0, 1].
        attentive: bool, looks before it drives.
        turn: () int32, who plans next.
        tracks: of the lot.
    """

    pose: jax.Array
    speed: jax.Array
    steering: jax.Array
    path: Path
    way: jax.Array
    phase: jax.Array
    track: jax.Array
    next_track: jax.Array
    bay: jax.Array
    clock: jax.Array
    stay: jax.Array
    aggressiveness: jax.Array
    attentive: jax.Array
    turn: jax.Array
    tracks: Tracks

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


def choose(mask: jax.Array, new: Tree, old: Tree) -> Tree:
    """Rows of one tree where the mask (n,) or () holds, elsewhere of another."""

    def pick(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(mask.reshape(*mask.shape, *[1] * (b.ndim - mask.ndim)), a, b)

    return jax.tree.map(pick, new, old)


def track_path(tracks: Tracks, track: jax.Array) -> Path:
    """Paths (n,) along tracks to their ends."""
    total = jnp.maximum(tracks.length[track] - NOSE, 0.1)
    return straight_path(tracks.pose[track], total, jnp.float32(RADIUS))
