"""Bays and the cars parked in them: which fit where, and which one is relocated.

An agent that has parked is replaced by a parked car, so that the numbers of parked cars
and of free bays stay the same (Tanner 2022, section 3.2.1).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm, to_world
from carpark_mj.geometry.obstacles import touches
from carpark_mj.layouts.types import Layout
from carpark_mj.types import NO_BAY, Events, ParkedCars, State

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

_Relocation = tuple[jax.Array, jax.Array, jax.Array]  # bays, moved, agents waiting

AWAY = 1e4  # m from the lot, where absent cars are placed in a row
_QUEUE = 20.0  # m between them


class BayFits(NamedTuple):
    """Bays that cars of different sizes can use; None = all of them."""

    agents: jax.Array | None = None  # (num_agents, bays) bool, can be an agent's goal
    parked_cars: jax.Array | None = None  # (num_parked_cars, bays) bool, can hold it


def fits(bay_size: jax.Array, car_size: jax.Array, slack: float = 0.0) -> jax.Array:
    """(..., bays) bool, cars (..., 2) that fit into bays (bays, 2) with `slack` [m]."""
    return jnp.all(car_size[..., None, :] + slack <= bay_size, axis=-1)


def bay_fits(
    config: EnvConfig, layout: Layout, agent_size: jax.Array, parked_size: jax.Array
) -> BayFits:
    """Bays that the cars of a lot can use; None where all cars are of one size.

    Agents of several kinds need the slack of the parked rule in force. Sizes are
    (num_agents, 2) and (num_parked_cars, 2) [m].
    """
    if not config.varies:
        return BayFits()
    agents = None
    if config.fleet.agents:
        agents = fits(layout.bay_size, agent_size, config.episode.slack)
    return BayFits(agents, fits(layout.bay_size, parked_size))


def free_bays(layout: Layout, taken: jax.Array) -> jax.Array:
    """(bays,) bool, the bays of a lot less those in `taken` (k,) int32."""
    return layout.bay_mask & ~marked(layout, taken)


def marked(layout: Layout, bay: jax.Array) -> jax.Array:
    """(bays,) bool, true at the indices `bay` (k,) int32; `NO_BAY` marks nothing."""
    # No scatter: XLA on a CPU aborts where it fuses this one for a single agent.
    return (bay[:, None] == jnp.arange(layout.num_bays)).any(axis=0)


def stand_in_bay(
    bay_pose: jax.Array, bay_size: jax.Array, size: jax.Array, offset: jax.Array
) -> jax.Array:
    """Poses (..., 3) of cars (..., 2) [m] in bays, off the middle by wished offsets.

    A car that fits into its bay stays within the lines: first its heading is clipped,
    then its position. A car that does not fit is centred. Offsets (..., 3) are in the
    bay's frame [m, m, rad].
    """
    # Turned by h, a box reaches r cos(h - phi) along and r sin(h + phi) across, with
    # its diagonal r and phi = atan(width / length).
    length, width = jnp.unstack(size, axis=-1)
    bay_length, bay_width = jnp.unstack(bay_size, axis=-1)
    x, y, yaw = jnp.unstack(offset, axis=-1)
    diagonal = norm(size)
    phi = jnp.arctan2(width, length)
    along, across = bay_length / diagonal, bay_width / diagonal
    free = jnp.pi / 2
    most = jnp.minimum(
        jnp.where(along < 1.0, phi - jnp.arccos(jnp.minimum(along, 1.0)), free),
        jnp.where(across < 1.0, jnp.arcsin(jnp.minimum(across, 1.0)) - phi, free),
    )
    most = jnp.maximum(most, 0.0)
    yaw = jnp.clip(yaw, -most, most)
    cos, sin = jnp.cos(yaw), jnp.abs(jnp.sin(yaw))
    gap_x = jnp.maximum(bay_length - (length * cos + width * sin), 0.0) / 2
    gap_y = jnp.maximum(bay_width - (length * sin + width * cos), 0.0) / 2
    x, y = jnp.clip(x, -gap_x, gap_x), jnp.clip(y, -gap_y, gap_y)
    return to_world(bay_pose, jnp.stack([x, y, yaw], axis=-1))


def poses_in_bays(layout: Layout, cars: ParkedCars) -> jax.Array:
    """Poses (num_parked_cars, 3) of parked cars in their bays; `AWAY` if absent."""
    pose = layout.parked_pose[cars.bay]
    if cars.offset is not None:
        size = layout.bay_size[cars.bay]
        pose = stand_in_bay(pose, size, cars.size, cars.offset)
    return jnp.where(cars.present[:, None], pose, _away(cars.bay.shape[0]))


def place_absent_agents(pose_w: jax.Array, present: jax.Array | None) -> jax.Array:
    """Poses (num_agents, 3) with those of absent agents `AWAY`; see `State.present`."""
    if present is None:
        return pose_w
    # Across the lot from absent parked cars.
    return jnp.where(present[:, None], pose_w, -_away(present.shape[0]))


def _away(count: int) -> jax.Array:
    """Poses (count, 3) where absent parked cars stand."""
    x = AWAY + _QUEUE * jnp.arange(count, dtype=jnp.float32)
    zero = jnp.zeros_like(x)
    return jnp.stack([x, zero, zero], axis=-1)


def in_bays(layout: Layout, cars: ParkedCars, bay: jax.Array) -> ParkedCars:
    """The parked cars moved to bays (num_parked_cars,) int32.

    A car that keeps its bay keeps its pose, also after it has been pushed.
    """
    moved = dataclasses.replace(cars, bay=bay)
    pose = poses_in_bays(layout, moved)
    pose = jnp.where((bay != cars.bay)[:, None], pose, cars.pose_w)
    return dataclasses.replace(moved, pose_w=pose)


def relocate_parked_cars(
    config: EnvConfig, state: State, events: Events, key: jax.Array
) -> ParkedCars:
    """Moves a parked car into every bay where an agent has just parked.

    `SpawnConfig.relocation` says which. A car moves at most once in a step, only into a
    bay that it fits into, and never to where a mover is. `key` is consumed.
    """
    cars, layout, rule = state.parked_cars, state.layout, config.spawn.relocation
    if cars.bay.shape[0] == 0:
        return cars
    # All of one size fit where one of them stands.
    parked_fits = fits(layout.bay_size, cars.size) if config.varies else None
    distance = norm(cars.pose_w[:, :2] - state.motion.xy[:, None]).min(axis=0)
    none = tracked = jnp.zeros(cars.bay.shape, bool)
    if rule == "random":
        tracked = tracks_parked_cars(config, state).any(axis=0)

    def move(carry: _Relocation) -> _Relocation:
        bay, moved, waiting = carry
        agent = jnp.argmax(waiting)
        goal = state.goal[agent]
        if rule != "furthest":
            agent_key = jax.random.fold_in(key, agent)
            score = jax.random.uniform(agent_key, bay.shape)
            score = score + jnp.where(tracked, 0.0, 1.0)
        else:
            score = distance
        able = ~moved & (bay != NO_BAY)
        if movers := state.movers.groups:
            inside = dataclasses.replace(cars, bay=jnp.full_like(bay, goal))
            there = poses_in_bays(layout, inside)
            able = able & ~touches(there, cars.size, movers)
        if parked_fits is not None:
            able = able & parked_fits[:, goal]
        car = jnp.argmax(jnp.where(able, score, -1.0))
        # Without one that is able this is none.
        moves = able & (jnp.arange(bay.shape[0]) == car)
        left = waiting & (jnp.arange(waiting.shape[0]) != agent)
        return jnp.where(moves, goal, bay), moved | moves, left

    # A loop over agents that have parked only: in most steps there are none.
    start = cars.bay, none, events.parked
    bay, *_ = jax.lax.while_loop(lambda carry: carry[2].any(), move, start)
    return in_bays(layout, cars, bay)


def tracks_parked_cars(config: EnvConfig, state: State) -> jax.Array:
    """(num_agents, num_parked_cars) bool, whether agents track cars, as measured."""
    found = config.observation.tracks_parked_cars(state)
    if found is None:
        return jnp.zeros((*state.goal.shape, *state.parked_cars.bay.shape), bool)
    return found if state.present is None else found & state.present[:, None]
