"""Persons, carts and cars that follow a script.

A script begins when a car comes near or after some time, whatever that car does. Its
mover goes straight or along a path, and back if it returns. One that yields never steps
into the stopping zone of a car, as pedestrians (`carpark_mj.movers.stopping`): it
waits, so that every contact can be avoided. It passes a car that stands at a smaller
distance, or both would wait for each other.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config.checks import NonNegative, Positive
from carpark_mj.geometry import box_distance, boxes_overlap, norm, rotate, to_local
from carpark_mj.geometry.obstacles import Boxes, Discs, ObstacleKind
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.stopping import MARGIN, STILL, cars_of, stopping_zones
from carpark_mj.obstacles import MOVERS, Mover
from carpark_mj.types import State

WAITS = -1.0  # s, clock of one that has not set out
AT_REST = 0.05  # m/s, a car that is slower stands
PASSING = 0.1  # m, the margin of the zone of a car that stands, instead of `MARGIN`
TURN = 1.0  # m, or half a leg, before and after a corner of a path, where a mover turns


@struct.dataclass
class Script:
    """A script and how far it is."""

    start: jax.Array  # (3,) pose at first [m, m, rad]
    direction: jax.Array  # () of travel [rad]
    distance: jax.Array  # () longest way [m]
    speed: jax.Array  # () at first [m/s]
    slowing: jax.Array  # () deceleration [m/s²]
    pause: jax.Array  # () at the end of the way, before the return [s]
    returns: jax.Array  # () bool
    # () distance ahead of a car, along its axis, at which it sets out [m]
    trigger: jax.Array
    # () distance between its centre and that of a car at which it sets out [m]
    near: jax.Array
    after: jax.Array  # () time after which it sets out [s]; inf = never
    yields: jax.Array  # () bool
    size: jax.Array  # (2,) length and width [m]; of a person twice the radius
    present: jax.Array  # () bool
    age: jax.Array  # () time since the lot began [s]
    # () time since it set out, without the time it waited [s]; or `WAITS`
    clock: jax.Array
    velocity: jax.Array  # (2,) [m/s]
    # (k, 4) of a path: way at `speed` [m]; x, y [m] and turn [rad] from the start, x
    # along `direction`. None = straight on
    path: jax.Array | None = None

    @property
    def pose(self) -> jax.Array:
        """(3,) where it is at its clock."""
        clock, speed = jnp.maximum(self.clock, 0.0), self.speed
        way = jnp.minimum(self.distance, speed**2 / jnp.maximum(2 * self.slowing, 1e-6))
        last = jnp.sqrt(jnp.maximum(speed**2 - 2 * self.slowing * way, 0.0))
        there = 2 * way / (speed + last)  # s, the time of the way out
        out = jnp.minimum(clock, there)
        along = speed * out - self.slowing * out**2 / 2
        back = speed * jnp.maximum(clock - there - self.pause, 0.0)
        along = jnp.where(self.returns, jnp.maximum(along - back, 0.0), along)
        move = jnp.stack([along, jnp.zeros_like(along)])
        if self.path is None:
            return self.start.at[:2].add(rotate(move, self.direction))
        columns = jax.vmap(jnp.interp, (None, None, 1))
        x, y, turn = columns(along, self.path[:, 0], self.path[:, 1:])
        move = rotate(jnp.stack([x, y]), self.direction)
        return self.start + jnp.append(move, turn)


@dataclasses.dataclass(frozen=True)
class Scripted(Mover):
    """Base of movers on a script; the first of its triggers sets it out.

    Attributes:
        start: pose at first [m, m, rad].
        direction: of travel [rad].
        distance: longest way [m].
        speed: at first [m/s].
        slowing: deceleration [m/s²].
        pause: at the end of the way, before the return [s].
        returns: whether it goes back.
        trigger: distance ahead of a car, along its axis [m]; 0 = never.
        near: distance between the centres of it and a car [m]; 0 = never.
        after: time since the lot began [s]; None = never.
        yields: whether it waits for cars that cannot stop.
        size: length and width [m]; of a person twice the radius.
        path: further points [m], the speeds to them [m/s], and headings there [rad] or
            none, instead of `direction` and `distance`; other values of `speed` than
            this one's change the speeds in proportion.
    """

    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: float = 0.0
    distance: Positive = 5.0
    speed: Positive = 1.0
    slowing: NonNegative = 0.0
    pause: NonNegative = 0.0
    returns: bool = False
    trigger: NonNegative = 6.0
    near: NonNegative = 0.0
    after: NonNegative | None = None
    yields: bool = True
    size: tuple[float, float] = (0.6, 0.6)
    path: tuple[tuple[float, ...], ...] = ()
    mover: str = ""

    def init(self, key: jax.Array, layout: Layout) -> Script:
        """It waits at its start."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values |= {"after": math.inf if self.after is None else self.after}
        del values["mover"]
        if self.path:
            values |= _follow(self.start, np.array(self.path, float), self.speed)
        else:
            del values["path"]
        arrays = {
            name: jnp.asarray(value, bool if type(value) is bool else jnp.float32)
            for name, value in values.items()
        }
        zero = jnp.float32(0.0)
        still = {"clock": zero + WAITS, "velocity": jnp.zeros(2), "age": zero}
        return Script(present=jnp.array(True), **arrays, **still)

    def step(self, key: jax.Array, state: Script, lot: State, dt: float) -> Script:
        """It goes on unless it would come nearer to a car that cannot stop."""
        local, age = to_local(lot.motion.pose_w, state.start), state.age + dt
        meets = (local[..., 0] > 0.0) & (local[..., 0] < state.trigger)
        meets = lot.active & (meets | (norm(local[..., :2]) < state.near))
        begins = (state.clock < 0.0) & (meets.any() | (age > state.after))
        clock = jnp.where(begins, 0.0, state.clock)
        clock = jnp.where(clock < 0.0, clock, clock + dt)
        there = dataclasses.replace(state, clock=clock)
        goes = ~state.yields | _is_free(state, there, lot, dt)
        clock = jnp.where(goes, clock, state.clock)
        after = dataclasses.replace(state, clock=clock, age=age)
        velocity = (after.pose - state.pose)[:2] / dt
        return dataclasses.replace(after, velocity=velocity)


def _follow(start: tuple[float, ...], path: np.ndarray, speed: float) -> Any:
    """Direction, distance and path of a script through points (n, 3 or 4)."""
    points = np.vstack([start[:2], path[:, :2]])
    legs = np.diff(points, axis=0)
    length, yaw = np.hypot(*legs.T), np.arctan2(legs[:, 1], legs[:, 0])
    corner = np.append(0.0, np.cumsum(length))
    if path.shape[1] > 3:
        turns, headings = corner, np.append(start[2], path[:, 3])
    else:
        reach = np.minimum(TURN, length / 2)
        turns = np.stack([corner[:-1] + reach, corner[1:] - reach], axis=1).ravel()
        headings = np.repeat(yaw, 2)
    headings = np.unwrap(headings)
    at = np.unique([*corner, *turns])
    way = np.append(0.0, np.cumsum(length * speed / path[:, 2]))
    local = (points - points[0]) @ [1, 1j] * np.exp(-1j * yaw[0])
    columns = [np.interp(at, corner, part) for part in (way, local.real, local.imag)]
    columns.append(np.interp(at, turns, headings - headings[0]))
    return {"direction": yaw[0], "distance": way[-1], "path": np.stack(columns, 1)}


def _is_free(now: Script, there: Script, lot: State, dt: float) -> jax.Array:
    """Whether it enters no stopping zone, nor nears a car whose zone it is in."""
    cars = cars_of(lot, dt)
    zones, stands = stopping_zones(cars, dt), jnp.abs(cars.speed) < AT_REST
    less = jnp.where(stands, MARGIN - PASSING, 0.0)
    middle = jnp.stack([(zones.ahead - zones.behind) / 2, 0 * zones.aside], axis=-1)
    yaw = zones.pose[:, 2]
    xy = zones.pose[:, :2] + rotate(middle, yaw)
    zone = jnp.concatenate([xy, yaw[:, None]], axis=-1)
    size = jnp.stack([zones.ahead + zones.behind, 2 * zones.aside], axis=-1)
    size = size - 2 * less[:, None]

    def seen(script: Script) -> tuple[jax.Array, jax.Array]:
        over = boxes_overlap(zone, size, script.pose, script.size)
        gap = box_distance(zones.pose, 2 * zones.half, script.pose, script.size)
        return over, gap

    (was_in, gap), (enters, gap_after) = seen(now), seen(there)
    leaves = was_in & (gap_after > gap - STILL)
    return ~(enters & ~leaves).any()


@dataclasses.dataclass(frozen=True)
class ScriptedPerson(Scripted):
    """A person on a script."""

    mover: str = "scripted_person"
    kind = ObstacleKind.PERSON

    def obstacles(self, state: Script) -> list[Discs]:
        """A disc."""
        radius, there = state.size[:1] / 2, state.present[None]
        return [Discs(state.pose[None, :2], radius, state.velocity[None], there)]


@dataclasses.dataclass(frozen=True)
class ScriptedBox(Scripted):
    """A cart or a car on a script."""

    mover: str = "scripted_box"

    def obstacles(self, state: Script) -> list[Boxes]:
        """A box."""
        velocity, there = state.velocity[None], state.present[None]
        return [Boxes(state.pose[None], state.size[None], velocity, there)]


MOVERS.register("scripted_person", ScriptedPerson())
MOVERS.register("scripted_box", ScriptedBox())
