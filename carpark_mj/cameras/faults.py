"""What is wrong with cameras: calibration, dirt, exposure and noise, drawn at random.

Faults last for an episode; noise is new in every picture.
"""

import dataclasses
from typing import Annotated

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.cameras.rig import Rig
from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Natural,
    NonNegative,
    Range,
)
from carpark_mj.geometry.se2 import norm


@dataclasses.dataclass(frozen=True)
class FaultConfig(CheckedConfig):
    """How wrong cameras can be; not at all by default.

    Attributes:
        turn: standard deviation of their mounting about each axis [rad].
        shift: standard deviation of their mounting along each axis [m].
        spots: number of spots of dirt on each lens.
        spot_size: largest radius of a spot over the height of the picture.
        exposure: range of the factor on brightness.
        depth_noise: standard deviation of the noise on depth over the depth.
        colour_noise: standard deviation of the noise on colours, which lie in [0, 1].
    """

    turn: NonNegative = 0.0
    shift: NonNegative = 0.0
    spots: Natural = 0
    spot_size: NonNegative = 0.1
    exposure: Annotated[Range, Bounds(ge=0.0)] = (1.0, 1.0)
    depth_noise: NonNegative = 0.0
    colour_noise: NonNegative = 0.0


@struct.dataclass
class Faults:
    """Faults of the cameras of cars (num_agents, cameras, ...).

    Attributes:
        turn: (..., 3, 3) rotations of the rays in the body's frame.
        shift: (..., 3) of the cameras in the body's frame [m].
        spots: (..., n, 3) row and column of dirt, and its radius, in picture heights.
        exposure: (...) factor on brightness.
    """

    turn: jax.Array
    shift: jax.Array
    spots: jax.Array
    exposure: jax.Array


def draw_faults(
    config: FaultConfig, rig: Rig, num_agents: int, key: jax.Array
) -> Faults:
    """Faults of an episode; `key` is consumed."""
    lead = (num_agents, len(rig.cameras))
    turn_key, shift_key, spot_key, exposure_key = jax.random.split(key, 4)
    angle = config.turn * jax.random.normal(turn_key, (*lead, 3))
    most = jnp.array([1.0, rig.width / rig.height, config.spot_size])
    low, high = config.exposure
    return Faults(
        turn=_rotation(angle),
        shift=config.shift * jax.random.normal(shift_key, (*lead, 3)),
        spots=most * jax.random.uniform(spot_key, (*lead, config.spots, 3)),
        exposure=jax.random.uniform(exposure_key, lead, minval=low, maxval=high),
    )


def noisy_depth(
    config: FaultConfig, depth: jax.Array, reach: float, key: jax.Array
) -> jax.Array:
    """Depths (...) [m] with noise, at most the reach; `key` is consumed."""
    noise = config.depth_noise * jax.random.normal(key, depth.shape)
    return jnp.where(depth < reach, jnp.clip(depth * (1.0 + noise), 0.0, reach), depth)


def _rotation(angle: jax.Array) -> jax.Array:
    """Rotations (..., 3, 3) by vectors (..., 3) [rad]."""
    cross = jnp.swapaxes(jnp.cross(angle[..., None, :], jnp.eye(3)), -1, -2)
    size = jnp.linalg.norm(angle, axis=-1)[..., None, None]
    first, second = jnp.sinc(size / jnp.pi), jnp.sinc(size / (2 * jnp.pi)) ** 2 / 2
    return jnp.eye(3) + first * cross + second * (cross @ cross)  # Rodrigues


def is_dirty(rig: Rig, spots: jax.Array) -> jax.Array:
    """Pixels (..., height, width) under any of the spots (..., n, 3)."""
    row = (jnp.arange(rig.height) + 0.5)[:, None] / rig.height
    column = (jnp.arange(rig.width) + 0.5) / rig.height
    place = spots[..., None, None, :]
    off = jnp.stack(
        jnp.broadcast_arrays(row - place[..., 0], column - place[..., 1]), axis=-1
    )
    return jnp.any(norm(off) < place[..., 2], axis=-3)
