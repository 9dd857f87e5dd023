"""Which agents of a lot can park in time, by a planner that sees and moves all of them.

Prioritised planning: cars drive in turn, each past those that still stand at their
starts and those that have parked, which stay in their bays (`planning.schedule`). A car
in the way of others first moves aside along its lane. Several orders are tried. What is
found is a witness; what is not found may still exist.

`impossible` is a necessary test: a disc as wide as each car moves among the cells of a
grid, alone and with that of every other car. A cell counts as free where any point of
it may be, so that discs pass wherever cars do; cars may still fail where discs pass.
"""

import dataclasses
import heapq
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from carpark_mj.planning.obstacles import FreeSpace, Solids, gaps
from carpark_mj.planning.paths import SHIFT_TIME, STEP, make_path, rear_axle
from carpark_mj.planning.policy import Sight
from carpark_mj.planning.schedule import DT, Drive, instants, meet, schedule
from carpark_mj.planning.search import SearchConfig, search

MARGIN = 0.02  # m on every side of a car that drives
ORDERS = 6
BREADTH = 3  # cars of an order among which the one that parks first is next
WAYS = 2  # of every car in a lot without others
TWO = {"paths": 2, "more_paths": 0}  # of a search
# Long steps: most of a lot is open, and a search that fails is soon given up.
ALONE = SearchConfig(
    (0.08, 0.02, 0.0), step=1.0, max_tests=2500, shorten_tests=1000, **TWO
)
PATIENT = SearchConfig((0.02,), max_tests=4000, **TWO)  # short steps, for tight bays
AROUND = dataclasses.replace(ALONE, clearances=(0.02,), paths=1, max_tests=1000)
ASIDE = (2.0, -2.0, 4.0, -4.0, 6.0, -6.0, 9.0, -9.0, 12.0, -12.0)  # m along its heading
MOVES = 2  # aside, of every car


class Answer(NamedTuple):
    """What is possible in a lot."""

    # of every agent; one that does not park stands at its start or aside
    drives: list[Drive]
    parks: np.ndarray  # (agents,) bool, whether the drive ends in the goal
    # (agents,) bool, whether there is a path in a lot without other agents
    alone: np.ndarray

    @property
    def arrival(self) -> np.ndarray:
        """(agents,) when they are parked [s]; inf where no way was found."""
        seconds = [drive.seconds for drive in self.drives]
        return np.where(self.parks, seconds, np.inf)


def solve(sights: Sequence[Sight], seconds: float, seed: int = 0) -> Answer:
    """Plans how all agents of a lot park, at rest at first, in `seconds` of an episode.

    `seed` is that of searches and orders.
    """
    return _Lot(sights, seed).solve(seconds)


class _Turns(NamedTuple):
    """Cars that have driven so far."""

    standing: list[np.ndarray]  # where each stands
    back: list[np.ndarray]  # the poses of each from there to its start
    drives: list[Drive]  # of each
    moves: np.ndarray  # how often each has moved aside
    parks: np.ndarray  # (agents,) bool, which have parked


class _Lot:
    """Plans for the cars of a lot."""

    def __init__(self, sights: Sequence[Sight], seed: int) -> None:
        self._sights, self._seed = sights, seed
        self._size = [np.array([s.car.length, s.car.width]) for s in sights]
        self._wide = [size + 2 * MARGIN for size in self._size]
        self._starts = [np.asarray(sight.pose, float) for sight in sights]
        pairs = zip(sights, self._size, strict=True)
        self._space = [FreeSpace(s.solids, tuple(x), s.extent) for s, x in pairs]
        self._ways = [self._find_ways(k) for k in range(len(sights))]
        # Ways past the others where they stand, and with which effort they were sought.
        self._found: dict[Any, tuple[int, list[np.ndarray]]] = {}
        self._effort = 1
        self._numbers = np.random.default_rng(seed)

    def solve(self, seconds: float) -> Answer:
        alone = np.array([bool(ways) for ways in self._ways])
        lengths = [len(ways[0]) if ways else np.inf for ways in self._ways]
        order, breadth = list(np.argsort(lengths, kind="stable")), len(lengths)
        answers: list[tuple[int, int, Answer]] = []
        for attempt in range(ORDERS):
            self._effort = 1 + attempt // 3
            turns = self._in_turn(order, breadth)
            answer = Answer(turns.drives, turns.parks, alone)
            late = answer.arrival > seconds
            answers.append((int((~late).sum()), int(turns.parks.sum()), answer))
            if not (late & alone).any():
                break
            if attempt % 2:
                order, breadth = list(self._numbers.permutation(len(order))), BREADTH
            else:  # late agents go first
                order, breadth = sorted(order, key=lambda k: not late[k]), 1
        return max(answers, key=lambda answer: answer[:2])[2]

    def _in_turn(self, order: list[int], breadth: int) -> _Turns:
        """All cars drive; next is the first to park of some first in an order."""
        count, still = len(order), np.zeros(1, int)
        places = zip(self._starts, self._size, strict=True)
        turns = _Turns(
            standing=list(self._starts),
            back=[np.zeros((0, 3))] * count,
            drives=[Drive(pose[None], still, size) for pose, size in places],
            moves=np.zeros(count, int),
            parks=np.zeros(count, bool),
        )
        while True:
            left = [k for k in order if not turns.parks[k] and self._ways[k]]
            drives = self._past_nobody(turns, left, breadth)
            if not drives:  # the first for which a way around the others is found
                tried = (self._first(turns, k, self._around(turns, k)) for k in left)
                drives = next(filter(None, tried), {})
            if drives:
                k = min(drives, key=lambda k: len(drives[k].point))
                turns.drives[k], turns.standing[k] = drives[k], drives[k].pose[-1]
                turns.parks[k] = True
            elif not self._make_way(turns, left):
                return turns

    def _past_nobody(
        self, turns: _Turns, left: list[int], breadth: int
    ) -> dict[int, Drive]:
        """Drives of at most that many cars whose way no standing car blocks."""
        found: dict[int, Drive] = {}
        for k in left:
            ways = [np.concatenate([turns.back[k], way]) for way in self._ways[k]]
            free = [way for way in ways if not self._hits(turns, k, way)]
            found |= self._first(turns, k, free)
            if len(found) == breadth:
                break
        return found

    def _make_way(self, turns: _Turns, left: list[int]) -> bool:
        """Moves a car that is in the way of another; whether it did."""
        ways = [
            (k, np.concatenate([turns.back[k], way]))
            for k in left
            for way in self._ways[k]
        ]
        blocked = [
            (other, way, self._wide[k])
            for k, way in ways
            for other in self._hits(turns, k, way)
            if not turns.parks[other] and turns.moves[other] < MOVES
        ]
        if any(self._move_aside(turns, *block, ASIDE) for block in blocked):
            return True
        # At least elsewhere: there may be a way around it.
        nowhere = np.zeros((0, 3))
        for k, _, size in blocked:
            distances = self._numbers.permutation(ASIDE).tolist()
            if self._move_aside(turns, k, nowhere, size, distances):
                return True
        return False

    def _move_aside(
        self,
        turns: _Turns,
        k: int,
        way: np.ndarray,
        size: np.ndarray,
        distances: Sequence[float],
    ) -> bool:
        """Moves car k straight on or back off the way of one of a size."""
        here, car = turns.standing[k], self._sights[k].car
        ahead = np.array([np.cos(here[2]), np.sin(here[2]), 0.0])
        for distance in distances:
            steps = np.linspace(0.0, distance, round(abs(distance) / STEP) + 1)
            path = make_path(rear_axle(car, here + steps[:, None] * ahead), car)
            if path is None:
                continue
            pose = instants(path, car)
            if meet(pose[-1:], self._wide[k], way, size).any():
                continue
            free = all(self._space[k].is_free(*place) for place in pose)
            if not free or self._hits(turns, k, pose):
                continue
            found = self._first(turns, k, [pose])
            if found:
                turns.drives[k], turns.standing[k] = found[k], found[k].pose[-1]
                pause = np.repeat(pose[:1], round(SHIFT_TIME / DT), axis=0)
                turns.back[k] = np.concatenate([pose[::-1], pause, turns.back[k]])
                turns.moves[k] += 1
                return True
        return False

    def _hits(self, turns: _Turns, k: int, path: np.ndarray) -> list[int]:
        """The other cars that stand on a path of car k."""
        return [
            other
            for other, pose in enumerate(turns.standing)
            if other != k
            and meet(path, self._wide[k], pose[None], self._size[other]).any()
        ]

    def _first(
        self, turns: _Turns, k: int, paths: list[np.ndarray]
    ) -> dict[int, Drive]:
        """The drive of car k that arrives first; none if others block all paths."""
        others = [drive for other, drive in enumerate(turns.drives) if other != k]
        own = turns.drives[k]
        begin, found = len(own.point) - 1, []
        for path in paths:
            index = schedule(path, self._wide[k], others, begin)
            if index is not None:
                index = np.concatenate([own.point, index[begin + 1 :] + len(own.pose)])
                pose = np.concatenate([own.pose, path])
                found.append(Drive(pose, index, self._size[k]))
        return {k: min(found, key=lambda drive: len(drive.point))} if found else {}

    def _find_ways(self, k: int) -> list[np.ndarray]:
        """Ways of car k in the lot without others, the quickest first."""
        sight, ways = self._sights[k], []
        # Through no other's bay, so that parked cars are in nobody's way.
        others = [other for other in range(len(self._sights)) if other != k]
        goals = [np.atleast_2d(self._sights[other].goal)[0] for other in others]
        full = self._with_cars(k, others, np.array(goals))
        for number in range(WAYS):
            ways += self._search(k, sight.pose, full, ALONE, number)
            if not ways:
                break
        for config in (ALONE, PATIENT):
            ways = ways or self._search(k, sight.pose, sight.solids, config)
        return sorted(ways, key=len)

    def _around(self, turns: _Turns, k: int) -> list[np.ndarray]:
        """A way of car k past the others where they stand; empty if none is found."""
        others = [other for other in range(len(self._sights)) if other != k]
        standing = np.array([turns.standing[other] for other in others])
        key = k, turns.standing[k].tobytes(), standing.tobytes()
        tried, ways = self._found.get(key, (0, []))
        if not ways and tried < self._effort:
            solids = self._with_cars(k, others, standing)
            tests = self._effort * AROUND.max_tests
            config = dataclasses.replace(AROUND, max_tests=tests)
            ways = self._search(k, turns.standing[k], solids, config, self._effort)
            self._found[key] = self._effort, ways
        return ways

    def _with_cars(self, k: int, others: list[int], pose: np.ndarray) -> Solids:
        """What stands still about car k, and others at poses (n, 3)."""
        size = np.array([self._size[other] for other in others]).reshape(-1, 2)
        return self._sights[k].solids.with_boxes(pose.reshape(-1, 3), size)

    def _search(
        self,
        k: int,
        start: np.ndarray,
        solids: Solids,
        config: SearchConfig,
        number: int = 0,
    ) -> list[np.ndarray]:
        """A path of car k to its goal as `instants`, or none."""
        sight, seeds = self._sights[k], (self._seed, k, number)
        path = search(
            start, sight.goal, solids, sight.car, sight.extent, seeds, config
        ).path
        return [] if path is None else [instants(path, sight.car)]


CELL = 0.4  # m
Cell = tuple[int, int]


def impossible(sights: Sequence[Sight]) -> np.ndarray:
    """(agents,) bool, agents that cannot park, or only if another does not."""
    discs = [_Disc(sight) for sight in sights]
    never = np.array([disc.start not in disc.left for disc in discs], bool)
    for a, b in itertools.combinations(np.flatnonzero(~never), 2):
        if not _both_reach(discs[a], discs[b]):
            never[[a, b]] = True
    return never


class _Disc:
    """The cells of a grid where the middle of a car may be.

    `start` is the cell of the car, free or not; `left` has the steps to the goal from
    every cell that it can be reached from.
    """

    def __init__(self, sight: Sight) -> None:
        self.radius = sight.car.width / 2
        counts = np.ceil(2 * sight.extent / CELL).astype(int)
        grid = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
        x, y = np.moveaxis((grid + 0.5) * CELL - sight.extent, -1, 0)
        nearest = gaps(sight.solids, x, y).min(-1, initial=np.inf)
        free = nearest > self.radius - CELL * np.sqrt(0.5)
        self._free = set[Cell](map(tuple, grid[free].tolist()))
        ends = sight.pose[:2], np.atleast_2d(sight.goal)[0, :2]
        self.start, goal = (
            tuple(((end + sight.extent) // CELL).astype(int).tolist()) for end in ends
        )
        self.left: dict[Cell, int] = {goal: 0} if goal in self._free else {}
        reached = [*self.left]
        for cell in reached:  # which grows
            for near in self.beside(cell):
                if near not in self.left:
                    self.left[near] = self.left[cell] + 1
                    reached.append(near)

    def beside(self, cell: Cell) -> list[Cell]:
        """The free cells next to a cell."""
        x, y = cell
        near = (x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)
        return [at for at in near if at in self._free]


def _both_reach(a: _Disc, b: _Disc) -> bool:
    """Whether two discs get to their goals without touching each other."""
    edge = [(a.left[a.start] + b.left[b.start], a.start, b.start)]
    reached = {(a.start, b.start)}
    while edge:  # nearest to both goals first
        left, one, two = heapq.heappop(edge)
        if left == 0:
            return True
        moves = [(near, two) for near in a.beside(one)]
        for cells in moves + [(one, near) for near in b.beside(two)]:
            (x, y), (u, v) = cells
            # The farthest that points of the two cells can be from each other.
            gap = CELL * math.hypot(abs(x - u) + 1, abs(y - v) + 1)
            if cells not in reached and gap > a.radius + b.radius:
                reached.add(cells)
                left = a.left[cells[0]] + b.left[cells[1]]
                heapq.heappush(edge, (left, *cells))
    return False
