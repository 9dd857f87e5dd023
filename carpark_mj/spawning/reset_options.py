"""Starts that the caller of `reset` sets; all others are drawn."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config import EnvConfig
from carpark_mj.geometry import boxes_overlap, wrap_angle
from carpark_mj.layouts.types import BayKind, Layout
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.parked_cars import bay_fits, marked
from carpark_mj.types import NO_BAY, State
from carpark_mj.vehicle.presets import fleet_cars

TOLERANCE = 1e-3  # m, rad or m/s by which a start may differ from what was asked for


@struct.dataclass
class ResetOptions:
    """How agents begin their first episodes; None and NaN mean drawn.

    Drawn goals, starts and parked cars do not overlap given ones. A parked car without
    a free bay is absent.

    Attributes:
        pose: (num_agents, 3) start poses of the footprints' centres in the world frame
            [m, m, rad]; a row of NaN = drawn.
        speed: (num_agents,) along the cars' axes, forwards positive, wheels rolling
            straight [m/s]; NaN = at rest.
        goal: (num_agents,) int32 bays, rows of `Layout.bay_pose`; `NO_BAY` = drawn.
            Fixed goals only.
        kind: (num_agents,) int32 cars of the fleet, rows of `fleet.agents` with those
            of a range one by one; -1 = drawn. A fleet of agents only.
    """

    pose: jax.Array | None = None
    speed: jax.Array | None = None
    goal: jax.Array | None = None
    kind: jax.Array | None = None


def read_reset_options(
    config: EnvConfig, options: ResetOptions | None
) -> ResetOptions | None:
    """Options of one lot as float32 and int32; None if nothing is given."""
    if options is None or not jax.tree.leaves(options):
        return None
    if options.goal is not None and config.goals.dynamic:
        raise ValueError("options.goal needs fixed goals, goals.dynamic = False")
    if options.kind is not None and not config.fleet.agents:
        raise ValueError("options.kind needs a fleet of cars, fleet.agents")
    if config.goals.drive_out and options.pose is not None and options.goal is None:
        raise ValueError(
            "options.pose needs options.goal where goals follow from drawn starts, "
            "goals.drive_out = True"
        )
    given: dict[str, jax.Array] = {}
    for name, value in vars(options).items():
        if value is None:
            continue
        wanted = (config.num_agents, 3) if name == "pose" else (config.num_agents,)
        if jnp.shape(value) != wanted:
            raise ValueError(
                f"options.{name} must be of shape {wanted}, not {jnp.shape(value)}"
            )
        whole = name in ("goal", "kind")
        if whole and not jnp.issubdtype(jnp.asarray(value).dtype, jnp.integer):
            raise ValueError(f"options.{name} must be whole numbers, not {value}")
        given[name] = jnp.asarray(value, jnp.int32 if whole else jnp.float32)
    return ResetOptions(**given)


def has_pose(options: ResetOptions) -> jax.Array:
    """(...) bool, the agents whose start poses are given."""
    assert options.pose is not None
    return ~jnp.isnan(options.pose).all(axis=-1)


def given_goals(options: ResetOptions | None, num_agents: int) -> jax.Array:
    """(num_agents,) int32 the goals that are given, else `NO_BAY`."""
    if options is None or options.goal is None:
        return jnp.full(num_agents, NO_BAY, jnp.int32)
    return options.goal


def kept_clear(layout: Layout, options: ResetOptions, size: jax.Array) -> jax.Array:
    """(bays,) bool, bays that are given as goals or in which a given start stands.

    `size` (2,) is the footprint of the largest car [m].
    """
    clear = jnp.zeros(layout.num_bays, bool)
    if options.goal is not None:
        clear = clear | marked(layout, options.goal)
    if options.pose is not None:
        pose = options.pose[:, None]
        over = boxes_overlap(pose, size, layout.bay_pose, layout.bay_size)
        clear = clear | (over & has_pose(options)[:, None]).any(axis=0)
    return clear & layout.bay_mask


def check_starts(config: EnvConfig, options: ResetOptions, state: State) -> None:
    """Refuses given starts of lots (lots, ...), or of one, that are impossible.

    `state` is that with which they began. The `ValueError` names the first such agent.
    """
    many = state.goal.ndim > 1
    if not many:
        options, state = jax.tree.map(lambda x: x[None], (options, state))
    for wrong, reason in _faults(config, options, state):
        if np.any(wrong):
            lot, agent = np.argwhere(np.asarray(wrong))[0].tolist()
            where = f"agent {agent} of lot {lot}" if many else f"agent {agent}"
            raise ValueError(f"reset options of {where}: {reason((lot, agent))}")


Fault = tuple[Any, Callable[[tuple[int, int]], str]]


def _faults(config: EnvConfig, options: ResetOptions, state: State) -> Iterator[Fault]:
    """Agents (lots, num_agents) bool with impossible starts, and the reason."""
    shape, layout, motion = state.goal.shape, state.layout, state.motion
    pose = np.full((*shape, 3), np.nan) if options.pose is None else options.pose
    speed = np.full(shape, np.nan) if options.speed is None else options.speed
    goal = np.full(shape, NO_BAY) if options.goal is None else options.goal
    pose, speed, goal = map(np.asarray, (pose, speed, goal))
    stands, rolls, aims = ~np.isnan(pose).all(-1), ~np.isnan(speed), goal != NO_BAY
    if state.present is not None:
        wrong = (stands | rolls | aims) & ~state.present
        yield wrong, lambda _: "the lot does not have it"

    wrong = ~np.isfinite(pose).all(-1)
    yield stands & wrong, lambda i: f"pose must be finite, not {pose[i].tolist()}"
    wrong = (np.abs(pose[..., :2]) > layout.extent[:, None]).any(-1)
    yield stands & wrong, lambda i: f"pose {pose[i].tolist()} is outside the lot"
    off = np.asarray(motion.pose_w) - pose
    off[..., 2] = wrap_angle(jnp.asarray(off[..., 2]))
    wrong = np.abs(off).max(-1) > TOLERANCE
    yield stands & wrong, lambda i: f"no car can stand at {pose[i].tolist()} exactly"

    car = state.physics.vehicle
    low, high = -car.max_reverse_speed, car.max_speed
    wrong = ~((low <= speed) & (speed <= high))
    yield (
        rolls & wrong,
        lambda i: (
            f"speed must lie in [{low[i]:.4g}, {high[i]:.4g}] m/s, not {speed[i]}"
        ),
    )
    wrong = np.abs(motion.speed - speed) > TOLERANCE
    yield rolls & wrong, lambda i: f"no car can have the speed {speed[i]} m/s exactly"

    bays, kinds = np.asarray(layout.bay_mask), np.asarray(layout.bay_kind)
    row = np.clip(goal, 0, bays.shape[1] - 1)
    wrong = (row != goal) | ~np.take_along_axis(bays, row, axis=1)
    yield (
        aims & wrong,
        lambda i: (
            f"no bay {goal[i]}: goals are from 0 to {np.flatnonzero(bays[i[0]])[-1]}"
        ),
    )
    held = np.asarray(state.goal)
    twice = (held[:, :, None] == held[:, None]) & ~np.eye(shape[1], dtype=bool)
    wrong = twice.any(-1) & (np.take_along_axis(kinds, row, axis=1) != BayKind.EXIT)
    yield aims & wrong, lambda i: f"bay {goal[i]} is also another agent's goal"
    find = jax.vmap(lambda *x: bay_fits(config, *x).agents)
    fits = find(layout, car.size, state.parked_cars.size)
    if fits is not None:
        wrong = ~np.take_along_axis(np.asarray(fits), row[..., None], axis=2)[..., 0]
        yield aims & wrong, lambda i: f"its car does not fit into bay {goal[i]}"

    if options.kind is not None:
        kind, most = np.asarray(options.kind), len(fleet_cars(config.fleet.agents)) - 1
        wrong = ~((kind >= -1) & (kind <= most))
        yield wrong, lambda i: f"kind must be from -1 to {most}, not {kind[i]}"
    boxes = dataclasses.replace(state, motion=dataclasses.replace(motion, touched=None))
    hits = _hits(boxes, config.episode.hitbox_scale)
    hit = functools.reduce(jnp.logical_or, hits.values())
    yield stands & hit, lambda _: "it would touch a car or a wall"


_hits = jax.jit(jax.vmap(find_hits, in_axes=(0, None)))
