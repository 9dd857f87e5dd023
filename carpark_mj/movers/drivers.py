"""Drivers: their places when a lot begins, and their next paths.

One driver plans in a step, and looks at one way in which it may go on. A path is taken
if the car sweeps no wall and no other bay on it, whether a car stands there or not.

- *Tracks*: the middle of a one-way lane, or the middle of each half of another, on the
  right. A lot without lanes has a counter-clockwise ring in its first spawn region.
  Where no other track can be reached a driver stands 2 s and leaves the lot. After at
  least 5 s it enters where a track begins on the border and no mover is within 9 m, or
  at any track if none begins there.
- *Paths*: a line, an arc of 3.5 m radius and a line: into another track, into a bay
  nose first, or backwards out of one. The bay must be free: no car, no agent's goal, no
  other driver's target. Every other arc ends 0.6 m to the left of its track, a wide
  turn that keeps off islands. A bay that becomes an agent's goal is vacated.
- *Car*: `city` as a kinematic bicycle (`advance` of the back end `bicycle`), four
  substeps in a control step, with the car's steering lock and rate, at most 2 m/s² and
  4 m/s². Pure pursuit (Coulter 1992) aims 1.2 m and 0.3 s ahead. Speeds are at most
  1.5 m/s in arcs and 0.8 m/s in reverse, and lower while the wheels still turn.
- *Distance*: the Intelligent Driver Model (Treiber, Hennecke and Helbing 2000, Physical
  Review E 62, 1805, "Congested traffic states in empirical observations and microscopic
  simulations") with b = 1.67 m/s² and exponent 4 as published, s0 = 1 m instead of
  2 m and a = 1 to 2 m/s² instead of 0.73 m/s². The gap is the free part of the path, up
  to 10.5 m, past drivers, stopping ways of agents, and people at present and in 1 s.
- *Right of way*: a car that backs out yields, then one that turns into a bay. Otherwise
  the car from the right goes first, and the oncoming before one that turns left. A car
  further in goes on. After 6 s at rest the longest wait goes first. After 12 s a driver
  that cannot turn off goes straight on, and one stuck at a bay goes back.
- *Attention*: an inattentive driver sees cars ahead, neither the right of way nor
  anything behind; it stops on contact. In the first 3 m out of a bay neighbouring cars
  limit every view to 1.5 m on either side per metre behind.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import Bounds, Count, Range, Ratio
from carpark_mj.geometry import boxes_overlap, move_forward, norm, to_world, wrap_angle
from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind, touches
from carpark_mj.layouts.types import BayEnd, BayKind, Layout
from carpark_mj.movers.driving import HARD, drive, is_clear
from carpark_mj.movers.traffic import (
    AWAY,
    BACK_OUT,
    DRIVE,
    NOSE,
    OFFSET,
    PARK,
    SIZE,
    STAY,
    Traffic,
    arcs_into,
    make_tracks,
    track_path,
)
from carpark_mj.obstacles import MOVERS, Mover
from carpark_mj.physics.base import where_cars
from carpark_mj.types import NO_BAY, State

EARLY = 10.0  # m before an arc, where a driver decides
NOT_LATE = 0.8  # m before it, besides the way in which the car stops
CROSSING = 5.5  # m from the end of a track to where another crosses it
SWING = 0.6  # m to the left of a track, where every other arc into it ends
BACK_ON = 0.3  # m along the track at the end of a way out of a bay
LONGEST = 12.0  # m to back out straight
POSES = 20  # on a path, tested for walls and bays
ROOM, ROOM_TO_WALLS = 0.15, 0.25  # m about the car there
# m by which bays are shorter and narrower to it
SLACK: Any = np.array([0.3, 0.4], np.float32)
ENTRY_INSET = 1.0  # m from the beginning of a track to the axle of a driver that enters
CLEAR = 9.0  # m about a car that comes in
ABSENCE = 5.0  # s, shortest
# Fields of `Traffic` that a plan changes.
MOTION = ("pose", "path", "way", "speed", "steering")
INTENT = ("phase", "track", "next_track", "bay", "clock")
TRIES = 8  # places that are tried for a driver
APART = 8.0  # m between drivers when a lot begins
FAR = 1e4  # m, where absent drivers are


def plan(key: jax.Array, traffic: Traffic, lot: State, search: float) -> Traffic:
    """Drivers after one has planned; `search` as of `Drivers`."""
    n = traffic.way.shape[0]
    who = traffic.turn
    own = jax.tree.map(
        lambda x: jax.lax.dynamic_index_in_dim(x, who.astype(jnp.uint32), 0, False),
        dataclasses.replace(traffic, turn=jnp.zeros(n, jnp.int32), tracks=jnp.zeros(n)),
    )
    own = dataclasses.replace(own, tracks=traffic.tracks)
    keys = jax.random.split(key, 5)
    parks = jax.random.uniform(keys[0]) < search
    turn_key, swing_key = jax.random.split(keys[1])
    most = max(own.tracks.mask.size, lot.layout.num_bays)
    # At once, as each call of the generator is a loop.
    draw = jax.vmap(partial(jax.random.gumbel, shape=(most,)))
    luck = draw(jnp.stack([turn_key, *keys[2:]]))
    turned, parked = _turn(swing_key, luck[0], own), _park(luck[1], own, traffic, lot)
    going_on = where_cars(parks & parked[1], parked, turned)
    backed = _back_out(luck[2], own, lot)
    stays = own.phase == STAY
    new, good = where_cars(stays, backed, going_on)
    path = new.path
    begin = jnp.where(stays, 0.0, jnp.maximum(path.straight - 1.5, own.way))
    end = jnp.minimum(path.arc_end + 4.0, path.total)
    ways = begin + (end - begin) * jnp.linspace(0.0, 1.0, POSES)
    good = good & _is_free(lot.layout, path.at(ways), new.bay)
    undecided = (own.phase == DRIVE) & (own.path.bend == 0.0)
    good = good & (undecided | stays)
    entered, enters = _enter(luck[3], own, traffic, lot)
    comes = (own.phase == AWAY) & (own.clock > ABSENCE) & enters
    new = where_cars(comes, entered, new)
    row = (jnp.arange(n) == who) & (good | comes)
    changes = {
        name: where_cars(row, getattr(new, name), getattr(traffic, name))
        for name in (*MOTION, *INTENT)
    }
    turn = (traffic.turn + 1) % n
    return dataclasses.replace(traffic, turn=turn, **changes)


def _begins_well(own: Traffic, start: jax.Array) -> jax.Array:
    """Whether arcs that begin after ways (k,) are not too near and not too far."""
    stop = own.speed * 0.4 + own.speed**2 / (2.0 * HARD) + NOT_LATE
    return (start > own.way + stop) & (start < own.way + stop + EARLY)


def _pick(
    luck: jax.Array, cost: jax.Array, good: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """A good choice, likelier where costs are low, and whether there is one."""
    score = luck[: cost.shape[0]] - cost
    index = jnp.argmax(jnp.where(good, score, -jnp.inf))
    return index, good.any()


def _turn(key: jax.Array, luck: jax.Array, own: Traffic) -> tuple[Traffic, jax.Array]:
    """A driver that turns into another track."""
    tracks = own.tracks
    length = tracks.length
    swing = jnp.where(jax.random.bernoulli(key), SWING, 0.0)
    beside = to_world(tracks.pose, jnp.stack([0.0, swing, 0.0]))
    arcs = arcs_into(beside, tracks.pose[own.track])
    good = tracks.mask & arcs.good & _begins_well(own, arcs.start)
    good = good & (arcs.along < length[own.track] + CROSSING)
    good = good & (arcs.beyond > -CROSSING) & (arcs.end < length - NOSE - 1.0)
    index, found = _pick(luck, jnp.zeros_like(arcs.start), good)
    path = arcs.path(index, length[index] - NOSE - arcs.end[index], 1.0)
    return dataclasses.replace(own, path=path, next_track=index), found


def _park(
    luck: jax.Array, own: Traffic, traffic: Traffic, lot: State
) -> tuple[Traffic, jax.Array]:
    """A driver that turns into a free bay."""
    layout = lot.layout
    pose = jnp.concatenate(
        [layout.bay_pose[:, :2], wrap_angle(layout.bay_pose[:, 2:] + jnp.pi)], axis=-1
    )
    arcs = arcs_into(pose, own.tracks.pose[own.track])
    rest = -OFFSET - arcs.end
    good = layout.bay_mask & (layout.bay_kind != BayKind.EXIT)
    if layout.bay_end is not None:
        good = good & (layout.bay_end != BayEnd.TAIL_FIRST)
    good = good & arcs.good & _begins_well(own, arcs.start)
    good = good & (rest > 0.0) & (arcs.beyond > -LONGEST)
    index, found = _pick(luck, jnp.zeros_like(rest), good)
    # A free bay is neither occupied nor the goal of another car.
    found = found & ~(lot.parked_cars.bay == index).any() & ~(lot.goal == index).any()
    found = found & ~((traffic.bay == index) & traffic.present).any()
    bay = layout.bay_pose[index], layout.bay_size[index]
    there = boxes_overlap(*bay, lot.motion.pose_w, lot.motion.size)
    path = arcs.path(index, rest[index], 1.0)
    new = dataclasses.replace(own, path=path, phase=jnp.int32(PARK), bay=index)
    return new, found & ~there.any()


def _back_out(luck: jax.Array, own: Traffic, lot: State) -> tuple[Traffic, jax.Array]:
    """A driver that backs out of a bay onto a track."""
    tracks = own.tracks
    lanes = tracks.pose.at[:, 2].add(jnp.pi)
    arcs = arcs_into(lanes, own.pose.at[2].add(jnp.pi))
    place = -(arcs.end + BACK_ON)
    good = tracks.mask & arcs.good & (arcs.start > 0.1) & (arcs.along < LONGEST)
    good = good & (place > 0.0) & (place < tracks.length - NOSE - 1.0)
    index, found = _pick(luck, arcs.along, good)
    path = arcs.path(index, jnp.float32(BACK_ON), -1.0)
    # Somebody needs the bay: go.
    due = (own.clock > own.stay) | (lot.goal == own.bay).any()
    new = dataclasses.replace(
        own,
        path=path,
        way=jnp.float32(0.0),
        phase=jnp.int32(BACK_OUT),
        next_track=index,
        clock=jnp.float32(0.0),
    )
    return new, found & due


def _enter(
    luck: jax.Array, own: Traffic, traffic: Traffic, lot: State
) -> tuple[Traffic, jax.Array]:
    """A driver that enters where a track begins."""
    tracks = own.tracks
    index, found = _pick(luck, jnp.zeros_like(tracks.length), tracks.entry)
    pose = move_forward(tracks.pose[index], ENTRY_INSET)
    ahead = move_forward(pose, NOSE)[:2]
    zero = jnp.float32(0.0)
    new = dataclasses.replace(
        own,
        pose=pose,
        speed=zero,
        steering=zero,
        path=track_path(tracks, index),
        way=jnp.float32(ENTRY_INSET),
        phase=jnp.int32(DRIVE),
        track=index,
        next_track=index,
        bay=jnp.int32(NO_BAY),
        clock=zero,
    )
    return new, found & is_clear(traffic, lot, ahead, CLEAR)


def _is_free(layout: Layout, pose: jax.Array, bay: jax.Array) -> jax.Array:
    """() bool, whether a car with its rear axle at poses (k, 3) meets nothing."""
    pose = move_forward(pose, OFFSET)[:, None]
    disc = jnp.pad(layout.disc_centre, ((0, 0), (0, 1)))
    discs = jnp.repeat(2.0 * layout.disc_radius[:, None], 2, axis=1)
    others = layout.bay_mask & (jnp.arange(layout.num_bays) != bay)
    bays, count = layout.bay_size - SLACK, layout.num_bays
    there = jnp.concatenate([layout.bay_pose, layout.wall_pose, disc])
    is_bay = (np.arange(there.shape[0]) < count)[:, None]
    size = SIZE + 2 * np.where(is_bay, np.float32(ROOM), np.float32(ROOM_TO_WALLS))
    sizes = jnp.concatenate([bays, layout.wall_size, discs])
    meets = boxes_overlap(pose, size, there, sizes)
    mask = jnp.concatenate([others, layout.wall_mask, layout.disc_mask])
    return ~(meets & mask).any()


@dataclasses.dataclass(frozen=True)
class Drivers(Mover):
    """Other drivers, in cars of the preset `city`.

    Attributes:
        number: how many. Drivers without room enter later.
        aggressiveness: a lot draws its level from this range, a driver from the level's
            neighbourhood; 0 drives the lowest speed with the longest headway, 1 the
            highest with the shortest, and accelerates twice as hard.
        attention: share of drivers that look for others before they drive.
        search: probability of looking for a bay where a way on is near, too.
        speed: of the least and the most aggressive [m/s].
        headway: of the most and the least aggressive [s]. Treiber et al. 2000: 1.6 s.
        stay: time in a bay [s].
    """

    number: Count = 4
    aggressiveness: Annotated[Range, Bounds(ge=0.0, le=1.0)] = (0.0, 1.0)
    attention: Ratio = 0.9
    search: Ratio = 0.7
    speed: Annotated[Range, Bounds(ge=0.5, le=4.0, unit="m/s")] = (1.5, 3.0)
    headway: Annotated[Range, Bounds(ge=0.5, le=5.0, unit="s")] = (1.0, 1.6)
    stay: Annotated[Range, Bounds(ge=0.0, le=3600.0, unit="s")] = (10.0, 40.0)
    mover: str = "drivers"
    kind = ObstacleKind.DRIVER

    def init(
        self, key: jax.Array, layout: Layout, others: Sequence[Group] = ()
    ) -> Traffic:
        """All stand in lanes, apart from each other."""
        n, tracks = self.number, make_tracks(layout)
        keys = jax.random.split(key, 6)
        usable = jnp.where(tracks.mask, jnp.maximum(tracks.length - 2 * NOSE, 0.0), 0.0)
        odds = jnp.where(usable > 0.0, jnp.log(usable), -jnp.inf)
        shape = (n, TRIES)
        luck = jax.random.gumbel(keys[0], (*shape, odds.shape[0]))
        track = jnp.argmax(odds + luck, axis=-1).astype(jnp.int32)
        way = NOSE + jax.random.uniform(keys[1], shape) * usable[track]
        pose = move_forward(tracks.pose[track], way)

        there = move_forward(pose, OFFSET).reshape(-1, 3)
        clear = ~touches(there, SIZE, others).reshape(shape) & usable.any()

        def place(taken: jax.Array, row: tuple[jax.Array, ...]):
            who, tried, free = row
            free = free & (norm(tried[:, None, :2] - taken) > APART).all(axis=-1)
            which, own = jnp.argmax(free), (jnp.arange(n) == who) & free.any()
            taken = jnp.where(own[:, None], tried[which, :2], taken)
            return taken, (which, free.any())

        rows = jnp.arange(n)
        nowhere = jnp.full((n, 2), FAR)
        _, (which, there) = jax.lax.scan(place, nowhere, (rows, pose, clear))
        track, way, pose = track[rows, which], way[rows, which], pose[rows, which]
        low, high = self.aggressiveness
        level = jax.random.uniform(keys[2], minval=low, maxval=high)
        single = jax.random.uniform(keys[3], (n,), minval=low, maxval=high)
        low, high = self.stay
        return Traffic(
            pose=jnp.where(there[:, None], pose, FAR),
            speed=jnp.zeros(n),
            steering=jnp.zeros(n),
            path=track_path(tracks, track),
            way=way,
            phase=jnp.where(there, DRIVE, AWAY).astype(jnp.int32),
            track=track,
            next_track=track,
            bay=jnp.full(n, NO_BAY, jnp.int32),
            clock=jnp.zeros(n),
            stay=jnp.full(n, low),
            aggressiveness=(level + single) / 2,
            attentive=jax.random.uniform(keys[4], (n,)) < self.attention,
            turn=jnp.int32(0),
            tracks=tracks,
        )

    begin = init

    def step(self, key: jax.Array, state: Traffic, lot: State, dt: float) -> Traffic:
        """They drive on, then one of them plans."""
        drive_key, plan_key = jax.random.split(key)
        state = drive(drive_key, state, lot, self.speed, self.headway, self.stay, dt)
        return plan(plan_key, state, lot, self.search)

    def obstacles(self, state: Traffic) -> list[Boxes]:
        """A box each."""
        size = jnp.broadcast_to(SIZE, (state.way.shape[0], 2))
        return [Boxes(state.centre, size, state.velocity, state.present)]


MOVERS.register("drivers", Drivers())
