"""Finds which agents of held-out lots can park within an episode; writes `oracle.csv`.

python eval/oracle.py --layout street --num-agents 8 --lots 30
python eval/oracle.py --layout dead_end,garage_row --num-agents 4 --out runs/oracle

A planner that sees and moves all cars answers for each lot at its start. What it finds
is a witness; what it does not find may still exist.

Prioritised planning: cars drive in turn, each past those that still stand at their
starts and those that have parked, which stay in their bays. A car in the way of others
first moves aside along its lane. Several orders are tried. A path is driven with a
trapezoidal speed profile; where another car is in the way, the car waits before it
pulls away or stops on its path, so that it arrives as early as possible (path-velocity
decomposition, Kant and Zucker 1986).
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("oracle", "oracle:main")

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import numpy as np
import shapely

from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import adapted
from carpark_mj.cli.process import MAX_EPISODES
from carpark_mj.cli.settings.driving import LotSettings
from carpark_mj.config.checks import Bounds, counted
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.evaluation.evaluator import allot
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.evaluation.tables import markdown
from carpark_mj.files import require_writable, write_csv
from carpark_mj.layouts import member_shares
from carpark_mj.planning.paths import (
    SHIFT_TIME,
    STEP,
    PlannedPath,
    centre,
    make_path,
    rear_axle,
    slow_down,
    speed_limit,
)
from carpark_mj.planning.policy import Sight, require_plannable, sights
from carpark_mj.planning.search import FreeSpace, SearchConfig, Solids, search
from carpark_mj.registry import environment
from carpark_mj.vehicle import VehicleParameters
from shell import command

OUTCOMES = "in time", "late", "none found"
DT = 0.2  # s between instants
CRUISE = 2.5  # m/s, highest speed
ACCELERATION = 1.5  # m/s^2, by which cars speed up and slow down
STOP = CRUISE / ACCELERATION  # s, least loss of a stop on the way
MARGIN = 0.02  # m on every side of a car that drives
ORDERS = 6
BREADTH = 3  # cars of an order among which the one that parks first is next
WAYS = 2  # of every car in a lot without others
TWO: Any = {"paths": 2, "slow": math.inf}  # of a search
# Long steps: most of a lot is open, and a search that fails is soon given up.
ALONE = SearchConfig(
    (0.08, 0.02, 0.0), step=1.0, max_tests=2500, shorten_tests=1000, **TWO
)
PATIENT = SearchConfig((0.02,), max_tests=4000, **TWO)  # short steps, for tight bays
AROUND = dataclasses.replace(ALONE, clearances=(0.02,), paths=1, max_tests=1000)
ASIDE = (2.0, -2.0, 4.0, -4.0, 6.0, -6.0, 9.0, -9.0, 12.0, -12.0)  # m along its heading
MOVES = 2  # aside, of every car


@dataclasses.dataclass(frozen=True)
class OracleConfig(LotSettings):
    """Settings of `python eval/oracle.py`.

    Attributes:
        environment: name of an environment, see `carpark_mj.registry`.
        lots: number of lots.
        out: folder for `oracle.csv`, a row per agent.
    """

    environment: str = "anywhere"
    lots: Annotated[int, Bounds(ge=1, le=MAX_EPISODES)] = 16
    out: str = ""


def run(config: OracleConfig) -> list[dict[str, Any]]:
    """Plans the lots, prints a table and writes the file; returns its rows."""
    task = adapted(config, environment(config.environment))
    env = ParkingEnv(task)
    require_plannable(env)
    if task.movers:
        raise ValueError("the oracle needs lots in which only agents move")
    file = Path(config.out) / "oracle.csv"
    if config.out:
        require_writable(file, new_folders=True)
    shares = member_shares(env.layout_config)
    doing(COMPILING)
    member = allot(list(shares.values()), config.lots)
    keys = jax.random.split(evaluation_key(config.seed), config.lots)
    state, _ = jax.jit(jax.vmap(lambda key, n: env.reset(key, "test", n)))(keys, member)
    seconds = task.episode.max_steps * task.sim.ctrl_dt
    doing(f"planning {counted(config.lots, 'lot')}, some seconds each")
    rows: list[dict[str, Any]] = []
    for lot, seen in enumerate(sights(state)):
        begun = {"lot": lot, "family": list(shares)[member[lot]]}
        for agent, at in enumerate(Lot(seen, config.seed).solve(seconds).arrival):
            late = "late" if np.isfinite(at) else "none found"
            row = begun | {"agents_present": len(seen), "agent": agent}
            row["outcome"] = "in time" if at <= seconds else late
            rows.append(row | {"arrival": float(at)})
        if config.out:  # after every lot: they take seconds each
            file.parent.mkdir(parents=True, exist_ok=True)
            write_csv(file, rows)
    print(describe(rows))
    if config.out:
        print(f"wrote {file}")
    return rows


def describe(rows: list[dict[str, Any]]) -> str:
    """A table of the outcomes [%] by family and number of agents, in Markdown."""
    cells: dict[Any, list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault((row["family"], row["agents_present"]), []).append(row)
    table: list[dict[str, Any]] = []
    for (family, agents), those in sorted(cells.items()):
        late = {row["lot"] for row in those if row["outcome"] != "in time"}
        lots = len({row["lot"] for row in those})
        cell: dict[str, Any] = {"family": family, "agents": agents, "lots": lots}
        for name in OUTCOMES:
            share = sum(row["outcome"] == name for row in those) / len(those)
            cell[name] = f"{100 * share:.1f}"
        found = lots - len(late)
        low, high = (100 * end for end in wilson_interval(found, lots))
        rate = f"{100 * found / lots:.1f} ({low:.1f} … {high:.1f})"
        table.append(cell | {"lots in time": rate})
    return markdown(table, left=2)


class Drive(NamedTuple):
    """What a car does from the beginning; afterwards it stands at the last pose."""

    # (n, 3) of the footprint's centre, without repetitions while it waits
    pose: np.ndarray
    point: np.ndarray  # (t,) which of them, at instants `DT` apart
    size: np.ndarray  # (2,) length and width [m]

    def at(self, instants: np.ndarray) -> np.ndarray:
        """Which poses, at these instants (k,)."""
        return self.point[np.minimum(instants, len(self.point) - 1)]

    @property
    def seconds(self) -> float:
        """Time of the arrival [s]."""
        return DT * (len(self.point) - 1)


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


class _Turns(NamedTuple):
    """Cars that have driven so far."""

    standing: list[np.ndarray]  # where each stands
    back: list[np.ndarray]  # the poses of each from there to its start
    drives: list[Drive]  # of each
    moves: np.ndarray  # how often each has moved aside
    parks: np.ndarray  # (agents,) bool, which have parked


class Lot:
    """Plans for the cars of a lot, at rest at first."""

    def __init__(self, sights: Sequence[Sight], seed: int = 0) -> None:
        """Finds ways without other cars; `seed` is that of searches and orders."""
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
        """How all agents park in `seconds` of an episode."""
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
            free = self._space[k].is_free(pose).all()
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
        """The drive of car k that arrives first, by k; none if others block all."""
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


def instants(path: PlannedPath, car: VehicleParameters) -> np.ndarray:
    """Poses (n, 3) of the footprint's centre, `DT` apart, on a path without stops."""
    now, wheels = 0.0, 0.0
    times, poses = [], []
    for segment in path.segments:
        gap = np.diff(segment.distance)
        now += abs(float(segment.steering[0]) - wheels) / car.steering_rate
        now += SHIFT_TIME if times else 0.0
        wheels = float(segment.steering[-1])
        speed = speed_limit(segment.distance, segment.steering, car, CRUISE)
        speed[[0, -1]] = 0.0
        slow_down(speed[::-1], gap[::-1], ACCELERATION)
        slow_down(speed, gap, ACCELERATION)
        taken = 2 * gap / (speed[1:] + speed[:-1])
        begun = now + np.concatenate([[0.0], np.cumsum(taken)])
        times.append(begun)
        poses.append(segment.pose)
        now = float(begun[-1])
    time, pose = np.concatenate(times), centre(car, np.concatenate(poses))
    yaw = np.unwrap(pose[:, 2])
    at = DT * np.arange(math.ceil(now / DT) + 1)
    return np.column_stack([np.interp(at, time, x) for x in (*pose[:, :2].T, yaw)])


def meet(
    pose: np.ndarray, size: np.ndarray, other: np.ndarray, other_size: np.ndarray
) -> np.ndarray:
    """(n, m) bool, which poses (n, 3), (m, 3) of two rectangles overlap."""
    found = np.zeros((len(pose), len(other)), bool)
    tree = shapely.STRtree(rectangles(other, other_size))
    found[tuple(tree.query(rectangles(pose, size), "intersects"))] = True
    return found


def rectangles(pose: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Shapely's polygons (n,) of a rectangle at poses (n, 3)."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    turn = np.moveaxis(np.array([[cos, sin], [-sin, cos]]), 2, 0)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2 * size
    return np.asarray(shapely.polygons(corners @ turn + pose[:, None, :2]))


def schedule(
    pose: np.ndarray, size: np.ndarray, others: list[Drive], begin: int
) -> np.ndarray | None:
    """The earliest arrival on a path among cars whose drives are known.

    Args:
        pose: (n, 3) of a car that drives without stops, `DT` apart.
        size: (2,) of it.
        others: drives of the other cars.
        begin: instant from which it may pull away.

    Returns:
        (t,) which pose at every instant from 0 to the arrival; None if there is none.
    """
    count, wait = len(pose), round(STOP / DT)
    last = max((len(other.point) for other in others), default=0)
    total = max(last, begin) + count + wait + 2
    free = np.ones((total, count), bool)
    for other in others:
        taken = meet(pose, size, other.pose, other.size)
        free &= ~taken[:, other.at(np.arange(total))].T
    stays = np.logical_and.accumulate(free[::-1, -1])[::-1]  # for good, at the end
    moves = np.zeros((total, count), bool)
    stood = np.zeros((total, count), int)
    stood[: begin + 1, 0] = wait
    for t in range(begin, total - 1):
        if stays[t] and (moves[t, -1] or stood[t, -1]):
            return _backtrack(moves, stood, t)
        goes = moves[t] | (stood[t] >= wait)
        # Free in all corners of the cell of time and path: nobody is passed through.
        clear = free[t + 1, 1:] & free[t, 1:] & free[t + 1, :-1]
        moves[t + 1, 1:] = goes[:-1] & clear
        stood[t + 1] = np.where(stood[t] > 0, stood[t] + 1, moves[t]) * free[t + 1]
    return None


def _backtrack(moves: np.ndarray, stood: np.ndarray, t: int) -> np.ndarray:
    """The poses from 0 to an arrival at instant t."""
    point, index = moves.shape[1] - 1, []
    driving = bool(moves[t, point])
    while point:
        if driving:
            index.append(point)
            t, point = t - 1, point - 1
            driving = bool(moves[t, point])
        else:
            pause = int(stood[t, point])
            index += [point] * pause
            t, driving = t - pause, True
    return np.array((index + [0] * (t + 1))[::-1])


main = command(OracleConfig, run, __doc__, fused=True)
