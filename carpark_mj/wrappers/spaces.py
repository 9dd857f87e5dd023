"""Gymnasium's spaces of what one agent observes and does."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import layout_config
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import Field, make_fields
from carpark_mj.observations.compose import BRIGHTEST, VECTOR
from carpark_mj.precision import is_real
from carpark_mj.vehicle import preset


def observation_space(config: EnvConfig) -> spaces.Box | spaces.Dict:
    """Space of what `ParkingEnv.unpack` gives: a vector, or that and pictures."""
    fields = make_fields(config)
    pictures = [field for field in fields if field.shape]
    vector = vector_space(config, (field for field in fields if not field.shape))
    if not pictures:
        return vector
    parts: dict[str, spaces.Space[Any]] = {VECTOR: vector}
    for field in pictures:
        parts[field.name] = spaces.Box(0, BRIGHTEST, field.shape, np.uint8)
    return spaces.Dict(parts)


def vector_space(config: EnvConfig, fields: Iterable[Field]) -> spaces.Box:
    """The vector (size,) float32 of some fields.

    Bounds are the ranges of the fields. If walls do not keep cars on the lot, or cars
    are faster than in a car park, bounds of lengths and speeds are what a car can reach
    in an episode; those of a yaw rate reach as far as the back end turns cars. Noise of
    sensors is unbounded.
    """
    fields = tuple(fields)
    size = [field.size for field in fields]
    more = np.array([_excess(config, field) for field in fields])
    low = np.array([field.low for field in fields])
    high = np.array([field.high for field in fields]) + more
    low = np.where(low < 0.0, low - more, low)
    low, high = (np.repeat(x.astype(np.float32), size) for x in (low, high))
    # Zeros are what absent and finished agents observe.
    return spaces.Box(np.minimum(low, 0.0), np.maximum(high, 0.0), dtype=np.float32)


def _excess(config: EnvConfig, field: Field) -> float:
    """By how much the numbers of a field may exceed its range."""
    lot, physics = layout_config(config.layout), config.physics_config
    fast = not physics.keeps_ranges
    varies = bool(field.metres or field.speed)
    if varies and config.sensors.is_on:
        return math.inf
    turns = physics.top_yaw_rate(config.sim.ctrl_dt) if field.is_yaw_rate else 0.0
    if turns > field.high:
        return turns - field.high
    if not varies or (lot.is_enclosed and not fast):
        return 0.0
    cars = [preset(name) for name in (config.vehicle, *config.fleet.agents)]
    fastest = 1.5 * max(max(c.max_speed, c.max_reverse_speed) for c in cars)
    if field.speed:
        return fastest / field.speed if fast else 0.0
    files = [part.layout for part in lot.parts if part.layout is not None]
    extent = max((float(np.max(x.extent)) for x in files), default=0.0)
    way = fastest * config.episode.max_steps * config.sim.ctrl_dt
    return 2.0 * (way + 2.0 * extent) / field.metres  # of two cars from each other


def action_space(spec: ActionSpec) -> spaces.Space[Any]:
    """The action of an agent.

    A `Box` of numbers in [-1, 1], a `MultiDiscrete` of indices, or a `Tuple` of both.
    """
    numbers = spaces.Box(-1.0, 1.0, (spec.continuous,), np.float32)
    if not spec.choices:
        return numbers
    indices = spaces.MultiDiscrete([*spec.choices], dtype=np.int32)
    return spaces.Tuple((numbers, indices)) if spec.continuous else indices


def flat_action(action: Any, spec: ActionSpec) -> np.ndarray:
    """An element of `action_space` as the vector (size,) that the environment takes.

    Raises:
        AssertionError: not of that space, but for numbers out of range.
    """
    try:
        parts = [np.asarray(x) for x in (action if type(action) is tuple else [action])]
        flat = np.concatenate(parts, axis=-1, dtype=np.float32)
        good = all(map(is_real, parts)) and flat.shape == (spec.size,)
    except (TypeError, ValueError):
        flat, good = np.zeros(0), False
    if not (good and np.isfinite(flat).all()):
        raise AssertionError(
            f"an action must be of {action_space(spec)}, not {action!r}"
        )
    return flat.astype(spec.dtype)
