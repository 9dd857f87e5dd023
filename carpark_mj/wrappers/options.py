"""What all adapters share: options of environments and of `reset`, and spaces."""

import dataclasses
import functools
import math
import reprlib
import typing
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict, TypeVar

import numpy as np
from gymnasium import spaces

from carpark_mj.config import (
    REWARDS,
    EnvConfig,
    LayoutChoice,
    PhysicsChoice,
    RewardConfig,
)
from carpark_mj.config.checks import is_finite, require_count, require_kind
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import layout_config
from carpark_mj.mdp.actions import ActionSpec, action_table
from carpark_mj.observations import Field, make_fields
from carpark_mj.observations.compose import BRIGHTEST, VECTOR
from carpark_mj.policy.runs import from_json
from carpark_mj.precision import is_real
from carpark_mj.registry import environment
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle.presets import fleet_cars


class Options(TypedDict, total=False):
    """Options of an environment, by keyword.

    Attributes:
        config: everything, an `EnvConfig` or the name of an environment of
            `carpark_mj.registry`; the other options change it.
        layout: `EnvConfig.layout`.
        agents: `EnvConfig.num_agents`.
        parked_cars: `EnvConfig.num_parked_cars`.
        vehicle: `EnvConfig.vehicle`.
        rule: `EpisodeConfig.parked_rule`.
        max_episode_steps: `EpisodeConfig.max_steps`.
        reward: weights, or the name of a set of them.
        physics: `EnvConfig.physics`.
        discrete: actions number rows of a table, `action_table`, or own rows (n, size).
        details: whether infos have `carpark_mj.wrappers.batch.details`, too.
    """

    config: EnvConfig | str
    layout: LayoutChoice
    agents: int
    parked_cars: int
    vehicle: str
    rule: str
    max_episode_steps: int
    reward: RewardConfig | str
    physics: PhysicsChoice
    discrete: bool | Sequence[Sequence[float]]
    details: bool


Env = TypeVar("Env", bound=ParkingEnv)
OPTIONS = tuple(Options.__annotations__)
_KINDS = typing.get_type_hints(Options)
_FIELDS = {
    **{name: name for name in ("layout", "vehicle", "physics")},
    **{name: f"num_{name}" for name in ("agents", "parked_cars")},
}
_EPISODE = {"rule": "parked_rule", "max_episode_steps": "max_steps"}


def configure(options: Options, allowed: tuple[str, ...] = OPTIONS) -> EnvConfig:
    """The configuration from options; `TypeError` of unknown ones.

    Configs may be dictionaries of their fields, as in the JSON of a Gymnasium spec.
    """
    require_options(options, allowed)
    require_kind("details", options.get("details", False), bool)
    given = {name: from_json(_KINDS[name], x) for name, x in options.items()}
    config = given.get("config", EnvConfig())
    if isinstance(config, str):
        config = environment(config)
    changes, episode = (
        {fields[name]: given[name] for name in fields if name in given}
        for fields in (_FIELDS, _EPISODE)
    )
    if episode:
        changes["episode"] = dataclasses.replace(config.episode, **episode)
    if "reward" in given:
        reward = given["reward"]
        changes["reward"] = REWARDS[reward] if isinstance(reward, str) else reward
    layout = changes.get("layout", config.layout)
    if isinstance(layout, str) and "." in layout:
        # Parameters instead of the name: environments are shared.
        changes["layout"] = layout_config(layout)
    return dataclasses.replace(config, **changes)


def require_options(options: Mapping[str, Any], allowed: Iterable[str]) -> None:
    """Refuses unknown options in Python's words, which TorchRL's `GymEnv` looks for."""
    for name in options:
        if name not in allowed:
            raise TypeError(
                f"got an unexpected keyword argument {name!r}; choose from "
                f"{sorted(allowed)}"
            )


@functools.lru_cache(maxsize=32)
def share(kind: type[Env], config: EnvConfig) -> Env:
    """The environment of one kind for a configuration, made and compiled only once."""
    return kind(config)


KEYS = ("pose", "speed", "goal")


def as_reset_options(
    options: Sequence[Mapping[str, Any] | None], shape: tuple[int, int]
) -> ResetOptions | None:
    """Options (lots, agents, ...) of those of single agents; None if all are empty.

    An agent's are `pose`, start pose (x, y, yaw) of the footprint's centre in the world
    frame [m, m, rad]; `speed`, forwards positive [m/s]; `goal`, the index of a bay.
    Missing poses and goals are drawn; a car without a speed begins at rest.
    """
    rows = [_checked(row) for row in options]
    if not any(rows):
        return None
    nothing = {"pose": (np.nan,) * 3, "speed": np.nan, "goal": NO_BAY}
    given: dict[str, Any] = {}
    for key, dtype in zip(KEYS, (np.float32, np.float32, np.int32), strict=True):
        if any(key in row for row in rows):
            each = np.array([row.get(key, nothing[key]) for row in rows], dtype)
            given[key] = each.reshape(*shape, *each.shape[1:])
    return ResetOptions(**given)


def _checked(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """The options of an agent."""
    require_kind("options", options, Mapping | None)
    row = dict(options or {})
    for key in row:
        if key not in KEYS:
            raise ValueError(f"unknown option {key!r} of reset; choose from {KEYS}")
    if "pose" in row:
        pose = row["pose"]
        if np.shape(pose) != (3,) or not all(map(is_finite, pose)):
            raise ValueError(
                f"pose must be three finite numbers (x, y, yaw), not {pose!r}"
            )
    if "speed" in row and not is_finite(row["speed"]):
        raise ValueError(f"speed must be a finite number, not {row['speed']!r}")
    if "goal" in row:
        require_count("goal", row["goal"], 0)
    return row


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
    cars = [car for _, car in fleet_cars((config.vehicle, *config.fleet.agents))]
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


def discrete_table(spec: ActionSpec, options: Options) -> np.ndarray | None:
    """The rows that discrete actions number, None of others.

    `ValueError` for rows that are no actions.
    """
    discrete: Any = options.get("discrete", False)
    if isinstance(discrete, bool):
        return action_table(spec) if discrete else None
    low = [-1.0] * spec.continuous + [0] * len(spec.choices)
    high = [1.0] * spec.continuous + [n - 1 for n in spec.choices]
    try:
        rows = np.array(discrete, np.float32)
        good = rows.ndim == 2 and ((low <= rows) & (rows <= high)).all()
        indices = rows[:, spec.continuous :] if good else rows
        good &= (indices == np.rint(indices)).all()
    except (TypeError, ValueError):
        rows, good = np.zeros(0), False
    if not (good and len(rows)):
        raise ValueError(
            f"discrete must be True or rows of {spec.size} numbers from {low} to "
            f"{high}, whole ones of choices, not {reprlib.repr(discrete)}"
        )
    return rows.astype(spec.dtype)


def require_numbers(spec: ActionSpec, table: np.ndarray | None) -> None:
    """Refuses actions that are no numbers, where no table numbers them."""
    if spec.choices and table is None:
        raise ValueError(
            "the grid and dynamic goals have actions that are indices: give "
            "discrete=True"
        )


def array_action_space(spec: ActionSpec, table: np.ndarray | None) -> spaces.Space[Any]:
    """The action of an agent as one array: numbers in [-1, 1], or indices."""
    if table is not None:
        return spaces.Discrete(len(table))
    if spec.continuous:
        require_numbers(spec, table)
    return action_space(spec)


def action_mask(spec: ActionSpec, table: np.ndarray | None, choices: np.ndarray) -> Any:
    """A mask of an agent's actions from that of its choices (n,) of a bay.

    Of rows of the table, (rows,) int8, or as `sample` of `action_space` takes it.
    """
    choices = choices.astype(np.int8)
    if table is not None:
        return choices[table[:, -1].astype(int)]
    parts = (*(np.ones(n, np.int8) for n in spec.choices[:-1]), choices)
    return (None, parts) if spec.continuous else parts


def look_up(table: np.ndarray, numbers: Any) -> np.ndarray:
    """The rows (..., size) of numbers (...); `ValueError` for what is none."""
    numbers = np.asarray(numbers)
    known = np.issubdtype(numbers.dtype, np.integer) and (
        (numbers >= 0) & (numbers < len(table))
    )
    if not np.all(known):
        raise ValueError(
            f"discrete actions must be integers from 0 to {len(table) - 1}, not "
            f"{reprlib.repr(numbers)}"
        )
    return table[numbers]
