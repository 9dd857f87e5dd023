"""Agents that drive on planned paths; they replan when they are stuck.

They know the true state of the lot: parked cars, walls and discs when they plan, the
positions of other agents and of movers while they drive. An agent slows down for
movers that are on its path or soon will be, stops for whatever is close, and after a
while plans around what is there.
Everything here is NumPy, on the host.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from carpark_mj.planning.obstacles import FreeSpace, Solids
from carpark_mj.planning.paths import CREEP, CRUISE, PlannedPath, centre, rear_axle
from carpark_mj.planning.search import Search, SearchConfig, search
from carpark_mj.planning.tracking import (
    STANDING,
    Command,
    Driven,
    Progress,
    brake,
    track,
)
from carpark_mj.vehicle import VehicleParameters

LOOK_AHEAD = 2.5  # m of the path that must be free, more than cars need to stop
FORESEEN = (0.0, 0.4, 0.8, 1.2, 1.6, 2.0)  # s, when movers must not be there
PACES = (CRUISE, 0.6, CREEP)  # m/s among movers; less must be free of them when slow
ROOM = 1.25  # m before movers that stand, to drive around them
PASSING = 0.2  # m kept from movers by a path that leads around them
GAP = 0.3  # m kept from them
PATIENCE = 20  # control steps until an agent that stands plans again
PATIENCE_MOVERS = 40  # the same where there are movers, which often go away
ASTRAY = 0.3  # m from the path: the agent replans
MAX_PLANS = 6  # of an episode


class Sight(NamedTuple):
    """An agent and what surrounds it in a control step.

    Attributes:
        begins: whether its episode has just begun.
        pose: (3,) of the footprint's centre.
        speed: signed [m/s].
        steering: [rad].
        goal: the bay's middle, see `search`.
        car: parameters of its car.
        solids: obstacles at rest.
        others: (k, 3) poses and (k, 2) sizes of the other agents.
        extent: (2,) of the lot [m].
        movers: (m, 3) poses, (m, 2) sizes and (m, 2) velocities of movers.
    """

    begins: bool
    pose: np.ndarray
    speed: float
    steering: float
    goal: np.ndarray
    car: VehicleParameters
    solids: Solids
    others: tuple[np.ndarray, np.ndarray]
    extent: np.ndarray
    movers: tuple[np.ndarray, np.ndarray, np.ndarray] = (
        np.zeros((0, 3)),
        np.zeros((0, 2)),
        np.zeros((0, 2)),
    )


class Agent:
    """One agent's path and how far it has driven it.

    Attributes:
        searches: of the running episode.
    """

    def __init__(self, seed: Sequence[int], dt: float, config: SearchConfig) -> None:
        """An agent without a path; `dt` is the control period [s]."""
        self.searches: list[Search] = []
        self._seed, self._dt, self._config = tuple(seed), dt, config
        self._path: PlannedPath | None = None
        self._progress = Progress()
        self._stuck = 0

    def act(self, sight: Sight) -> tuple[float, float]:
        """Steer and pedal in [-1, 1]."""
        if sight.begins:
            self.searches = []
            self._plan(sight, sight.solids)
        command = self._follow(sight)
        if command is not None and command.error > ASTRAY:
            self._plan(sight, sight.solids)
        # Wheels that turn from lock to lock take less time than the patience.
        self._stuck = self._stuck + 1 if abs(sight.speed) < STANDING else 0
        pose, size, _ = sight.movers
        if self._stuck >= (PATIENCE_MOVERS if len(pose) else PATIENCE):
            solids = sight.solids.with_boxes(*sight.others)
            self._plan(sight, solids.with_boxes(pose, size + 2 * PASSING))
        pace = self._pace(sight)
        command = self._follow(sight, pace)
        if pace == 0.0 or command is None:
            return 0.0, brake(sight.speed, sight.car, self._dt)
        self._progress = command.progress
        return command.steer, command.pedal

    def _plan(self, sight: Sight, solids: Solids) -> None:
        """Searches a path; the old one stays if there is none."""
        self._stuck = 0
        if len(self.searches) >= MAX_PLANS:
            return
        seed = *self._seed, len(self.searches)
        found = search(
            sight.pose, sight.goal, solids, sight.car, sight.extent, seed, self._config
        )
        if found.path is not None or not self.searches:
            self._path, self._progress = found.path, Progress()
        self.searches.append(found)

    def _follow(self, sight: Sight, pace: float = CRUISE) -> Command | None:
        if self._path is None:
            return None
        driven = Driven(rear_axle(sight.car, sight.pose), sight.speed, sight.steering)
        return track(self._path, self._progress, sight.car, driven, self._dt, pace)

    def _pace(self, sight: Sight) -> float:
        """The highest speed [m/s] at which nothing gets in the way; 0 = stop."""
        if not self._is_free(sight, LOOK_AHEAD, GAP, *sight.others):
            return 0.0
        pose, size, velocity = sight.movers
        still = np.hypot(*velocity.T) < STANDING
        stand = pose[still], size[still]
        if not self._is_free(sight, ROOM, GAP * CREEP / CRUISE, *stand):
            return 0.0
        for pace in PACES:
            share = pace / CRUISE
            foreseen = FORESEEN if pace > CREEP else (0.0,)
            moves = (velocity * (share * seconds) for seconds in foreseen)
            there = [pose + np.pad(move, ((0, 0), (0, 1))) for move in moves]
            soon = np.concatenate(there), np.tile(size, (len(there), 1))
            if self._is_free(sight, LOOK_AHEAD * share, GAP * share, *soon):
                return pace
        return 0.0

    def _is_free(
        self, sight: Sight, way: float, gap: float, pose: np.ndarray, size: np.ndarray
    ) -> bool:
        """Whether boxes (k, 3), (k, 2) leave a gap to the next stretch of the path."""
        reach = math.hypot(sight.car.length, sight.car.width) + way + gap
        near = np.hypot(*(pose[:, :2] - sight.pose[:2]).T) < reach + size.max(
            axis=-1, initial=0.0
        )
        path, (number, point) = self._path, self._progress
        if path is None or number == len(path.segments) or not near.any():
            return True
        segment = path.segments[number]
        ahead = segment.distance - segment.distance[point]
        points = segment.pose[(ahead >= 0) & (ahead <= way)][::10]
        nothing = Solids(pose[near], size[near], np.zeros((0, 2)), np.zeros(0))
        wide = sight.car.length + 2 * gap, sight.car.width + 2 * gap
        here = FreeSpace(nothing, wide, sight.extent, grid=False)
        return all(here.is_free(*place) for place in centre(sight.car, points))
