"""Drivers: cars that follow rules, drawn when a lot begins."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Range, require_range, require_ratio, require_whole
from carpark_mj.config.obstacles import MOVERS, Mover, ObstacleKind
from carpark_mj.geometry import move_forward, norm
from carpark_mj.geometry.obstacles import Boxes, Group, touches
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.driving import drive
from carpark_mj.movers.planning import plan
from carpark_mj.movers.tracks import make_tracks
from carpark_mj.movers.traffic import (
    AWAY,
    DRIVE,
    NOSE,
    OFFSET,
    SIZE,
    Traffic,
    track_path,
)
from carpark_mj.types import NO_BAY, State

TRIES = 8  # places that are tried for a driver
APART = 8.0  # m between drivers when a lot begins
FAR = 1e4  # m, where those are who are away


@dataclasses.dataclass(frozen=True)
class Drivers(Mover):
    """Other drivers, in cars of the preset `city`.

    Attributes:
        number: how many, the most if `aggressiveness` is given. Fewer are there at
            first in a lot without room for all; they come in later.
        aggressiveness: a lot draws its level from this range, a driver from the level's
            neighbourhood; 0 drives the lowest speed with the longest headway, 1 the
            highest with the shortest, and accelerates twice as hard.
        attention: share of drivers who look for others before they drive.
        search: probability of looking for a bay, rather than for a way on, where both
            are near.
        speed: of the least and the most aggressive [m/s].
        headway: of the most and the least aggressive [s]. Treiber et al. 2000: 1.6 s.
        stay: time in a bay [s].
        mover: fixed.
    """

    number: int = 4
    aggressiveness: Range = (0.0, 1.0)
    attention: float = 0.9
    search: float = 0.7
    speed: Range = (1.5, 3.0)
    headway: Range = (1.0, 1.6)
    stay: Range = (10.0, 40.0)
    mover: str = "drivers"
    kind = ObstacleKind.DRIVER

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 1, "number")
        require_ratio(self, "attention", "search")
        require_range("aggressiveness", self.aggressiveness, 0.0, 1.0)
        require_range("speed", self.speed, 0.5, 4.0)
        require_range("headway", self.headway, 0.5, 5.0)
        require_range("stay", self.stay, 0.0, 3600.0)

    def init(self, key: Any, layout: Layout, others: Sequence[Group] = ()) -> Traffic:
        """All stand in lanes, apart from each other."""
        n, tracks = self.number, make_tracks(layout)
        keys = jax.random.split(key, 6)
        usable = jnp.where(tracks.mask, jnp.maximum(tracks.length - 2 * NOSE, 0.0), 0.0)
        odds = jnp.where(usable > 0.0, jnp.log(usable), -jnp.inf)
        shape = (n, TRIES)
        track = jnp.argmax(
            odds + jax.random.gumbel(keys[0], (*shape, odds.shape[0])), axis=-1
        ).astype(jnp.int32)
        way = NOSE + jax.random.uniform(keys[1], shape) * usable[track]
        pose = move_forward(tracks.pose[track], way)

        there = move_forward(pose, OFFSET).reshape(-1, 3)
        clear = ~touches(there, SIZE, others).reshape(shape) & usable.any()

        def place(taken: jax.Array, row: tuple[jax.Array, ...]):
            who, tried, free = row
            free = free & (norm(tried[:, None, :2] - taken) > APART).all(axis=-1)
            which = jnp.argmax(free)
            taken = jnp.where(
                ((jnp.arange(n) == who) & free.any())[:, None], tried[which, :2], taken
            )
            return taken, (which, free.any())

        nowhere = jnp.full((n, 2), FAR)
        rows = jnp.arange(n), pose, clear
        _, (which, there) = jax.lax.scan(place, nowhere, rows)
        rows = jnp.arange(n)
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

    def begin(self, key: Any, layout: Layout, others: Sequence[Group]) -> Traffic:
        """Clear of others."""
        return self.init(key, layout, others)

    def step(self, key: Any, state: Traffic, lot: State, dt: float) -> Traffic:
        """They drive on, then one of them plans."""
        drive_key, plan_key = jax.random.split(key)
        state = drive(drive_key, state, lot, self.speed, self.headway, self.stay, dt)
        return plan(plan_key, state, lot, self.search)

    def obstacles(self, state: Traffic) -> list[Boxes]:
        """A box each."""
        size = jnp.broadcast_to(SIZE, (state.way.shape[0], 2))
        return [Boxes(state.centre, size, state.velocity, state.present)]


MOVERS.register("drivers", Drivers())
