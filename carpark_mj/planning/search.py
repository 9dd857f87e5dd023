"""Paths by OMPL: RRT-Connect in the space of Reeds and Shepp, shortened.

A tight bay is left by many short moves, of which random samples find few. So a lattice
of moves at full lock or straight on leads out of the bay and away from the start, with
the fewest moves. RRT-Connect (Kuffner and LaValle, ICRA 2000; Sucan, Moll and Kavraki,
*The Open Motion Planning Library*, 2012) joins the two: it grows a tree from either
side and restarts when it takes long. It mostly ends in the first of its goals, so they
are drawn at random. Of a few paths the quickest to drive is taken. The number of
collision tests ends a search, not time.
"""

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from carpark_mj.extensions import require_packages
from carpark_mj.layouts.types import BayKind, Layout
from carpark_mj.planning.obstacles import FreeSpace, Solids
from carpark_mj.planning.paths import STEP, PlannedPath, centre, make_path, rear_axle
from carpark_mj.vehicle import VehicleParameters


@dataclasses.dataclass(frozen=True)
class SearchConfig:
    """How paths are searched."""

    # distances to keep from obstacles [m]; the first with a path not slow counts
    clearances: tuple[float, ...] = (0.08, 0.05, 0.02)
    # share of the full lock that is left to the tracking controller
    spare_steering: float = 0.05
    step: float = 0.3  # longest extension of a tree [m]
    paths: int = 4  # how many paths are searched for, at each clearance
    slow: float = 70.0  # [s], from which the next clearance may lead to a quicker one
    max_tests: int = 8_000  # collision tests of a search, after which it is given up
    shorten_tests: int = 3_000  # collision tests that shorten a path
    resolution: float = 0.05  # distance between tested poses [m]
    # lengths of a lattice's moves [m], each tried where longer ones do not lead out
    moves: tuple[float, ...] = (0.05, 0.03)
    max_poses: int = 60_000  # of a lattice, after which it is given up


class Search(NamedTuple):
    """The result of a search."""

    path: PlannedPath | None  # None if none was found
    seconds: float  # CPU time [s]
    clearance: float  # distance kept from obstacles [m]; NaN without a path


def search(
    start: np.ndarray,
    goal: np.ndarray,
    solids: Solids,
    car: VehicleParameters,
    extent: np.ndarray,
    seed: int | Sequence[int] = 0,
    config: SearchConfig | None = None,
) -> Search:
    """Searches a path to a bay, nose in or nose out.

    Where start or goal are nearer to obstacles than the least clearance, half of their
    distance is kept.

    Args:
        start: (3,) pose of the footprint's centre.
        goal: (3,) of the bay's middle, either way round; (1, 3) if only that way.
        solids: obstacles to keep clear of.
        car: that drives.
        extent: (2,) half widths of the lot [m].
        seed: of the random numbers; several numbers are one seed.
        config: of the search; the defaults if None.
    """
    config, begun = config or SearchConfig(), time.thread_time()
    seeds = np.random.SeedSequence(seed).generate_state(config.paths).tolist()
    lock = car.max_steering * (1.0 - config.spare_steering)
    curvature = math.tan(lock) / car.wheelbase
    size, ends = np.array([car.length, car.width]), _poses_in_bay(goal)
    both = np.stack([start, ends[0]])
    room = FreeSpace(solids, size, extent).room(both).min() / 2
    away = min(AWAY, math.dist(*both[:, :2]) / 2)
    clearances = [*config.clearances, *[room] * int(room < config.clearances[-1])]
    best = Search(None, 0.0, math.nan)
    for clearance in clearances:
        space = FreeSpace(solids, size + 2 * clearance, extent, car.centre_offset)
        starts, goals = (
            _ways_out(rear_axle(car, side), space, car, curvature, away, config)
            for side in (start[None], ends)
        )
        for own_seed in seeds if len(starts.out) and len(goals.out) else ():
            path = _connect(starts, goals, space, car, curvature, config, own_seed)
            if path and (not best.path or path.duration < best.path.duration):
                best = best._replace(path=path, clearance=clearance)
        if best.path and best.path.duration <= config.slow:
            break
    return best._replace(seconds=time.thread_time() - begun)


def _poses_in_bay(goal: np.ndarray) -> np.ndarray:
    """Poses in a bay (n, 3), nose in and nose out, in the same order for both."""
    if goal.ndim == 2:
        return np.array([[*pose[:2], _wrap(pose[2])] for pose in goal])
    turned = ([*goal[:2], _wrap(goal[2] + turn)] for turn in (0.0, math.pi))
    return np.array(sorted(turned))


def _wrap(yaw: Any) -> Any:
    """Directions in [-pi, pi): OMPL leaves out states beyond its bounds."""
    turn = 2 * math.pi
    return (yaw + math.pi) % turn % turn - math.pi  # rounded, the first may be a turn


AWAY = 1.8  # m from where a lattice begins to where it is left
LEAST = 0.08  # m, of a lattice's moves: a car cannot drive shorter ones exactly
EXITS = 8  # of a lattice, for a search


class _Ways(NamedTuple):
    """Ways out of a tight place, from poses of a lattice to where it begins."""

    pose: np.ndarray  # (n, 3) of the rear axle
    before: np.ndarray  # (n,) index of where the move to it began; -1 = none
    out: np.ndarray  # indices of those that are outside

    def way(self, pose: np.ndarray) -> np.ndarray:
        """(m, 3) from a pose of the lattice to where it begins."""
        index, way = int(np.abs(self.pose - pose).sum(axis=1).argmin()), []
        while index >= 0:
            way.append(index)
            index = int(self.before[index])
        return self.pose[way]


def _ways_out(
    begin: np.ndarray,
    space: FreeSpace,
    car: VehicleParameters,
    curvature: float,
    away: float,
    config: SearchConfig,
) -> _Ways:
    """The fewest moves from poses (k, 3) of the rear axle to those so far away [m].

    A breadth-first search: of all poses that n moves reach, six moves of any length
    lead to those that n + 1 reach. One pose stands for all in its cell.
    """
    ways = _Ways(begin, np.zeros(0, int), np.zeros(0, int))
    for move in config.moves:
        if not len(ways.out):
            ways = _lattice(begin, space, car, curvature, away, move, config.max_poses)
    return ways


def _lattice(
    begin: np.ndarray,
    space: FreeSpace,
    car: VehicleParameters,
    curvature: float,
    away: float,
    move: float,
    most: int,
) -> _Ways:
    """`_ways_out` with moves of multiples of `move` [m], of at `most` so many poses."""
    cell = np.array([move / 3, move / 3, 0.6 * move * curvature])
    seen, poses, before = set[tuple[int, ...]](), list[np.ndarray](), list[np.ndarray]()

    def keep_free(pose: np.ndarray, source: np.ndarray) -> tuple[np.ndarray, ...]:
        kept = space.is_free(pose)
        return pose[kept], source[kept]

    def add(pose: np.ndarray, source: np.ndarray) -> tuple[np.ndarray, ...]:
        """Those of the poses that are new and free, and their sources; adds them."""
        pose[:, 2] = _wrap(pose[:, 2])
        cells = map(tuple, np.floor(pose / cell).astype(int).tolist())
        new = [k for k, own in enumerate(cells) if not (own in seen or seen.add(own))]
        pose, source = keep_free(pose[new], source[new])
        poses.append(pose)
        before.append(source)
        return pose, source

    def is_far(pose: np.ndarray) -> np.ndarray:
        return np.hypot(*(centre(car, pose) - middle)[:, :2].T) >= away

    middle = centre(car, begin[0])
    add(begin.copy(), np.full(len(begin), -1))
    first = 0
    while True:
        whole = np.concatenate(poses)
        index = np.arange(first, len(whole))
        far = is_far(whole[first:])
        if far.any() or not len(index) or len(whole) > most:
            return _Ways(whole, np.concatenate(before), index[far])
        first = len(whole)
        for way, side in itertools.product((move, -move), (-curvature, 0.0, curvature)):
            now, source, turn = whole[index], index, way * side
            chord = way * np.sinc(turn / (2 * math.pi))
            length = 0.0
            while len(now):
                length += move
                ahead = now[:, 2] + turn / 2
                step = chord * np.cos(ahead), chord * np.sin(ahead), turn + 0 * ahead
                keep = add if length > min(LEAST, away / 2) else keep_free
                now, source = keep(now + np.stack(step, axis=1), source)
                near = ~is_far(now)
                now, source = now[near], source[near]


@functools.cache
def _ompl() -> Any:
    from ompl import base, geometric, util  # pyright: ignore[reportMissingImports]

    util.setLogLevel(util.LogLevel.LOG_NONE)
    return base, geometric, util


class _Counter:
    """Counts collision tests; beyond the limit no pose is free.

    RRT-Connect checks whether to stop only between its rounds, and a round lasts as
    long as moves towards the other tree are free. Sometimes moves of Reeds and Shepp
    come no nearer to it, and the round would never end.
    """

    def __init__(self, test: Callable[[Any], bool]) -> None:
        self.test, self.left, self.searches = test, 0, True

    def __call__(self, state: Any) -> bool:
        self.left -= 1
        return (self.left >= 0 or not self.searches) and self.test(state)


def _connect(
    starts: _Ways,
    goals: _Ways,
    space: FreeSpace,
    car: VehicleParameters,
    curvature: float,
    config: SearchConfig,
    seed: int,
) -> PlannedPath | None:
    """One search and its path between where two lattices begin, or None."""
    base, geometric, util = _ompl()
    util.RNG.setSeed(max(seed, 1))  # 0 is none
    curves = base.ReedsSheppStateSpace(1.0 / curvature)
    bounds = base.RealVectorBounds(2)
    for axis, half in enumerate(space.extent.tolist()):
        bounds.setLow(axis, -half)
        bounds.setHigh(axis, half)
    curves.setBounds(bounds)
    curves.setLongestValidSegmentFraction(config.resolution / curves.getMaximumExtent())
    count = _Counter(lambda state: bool(space.is_free(np.array(_pose(state)))))
    setup = geometric.SimpleSetup(curves)
    setup.setStateValidityChecker(count)
    information = setup.getSpaceInformation()
    ends = base.GoalStates(information)
    draw = np.random.default_rng(seed)
    for ways, add in ((starts, setup.addStartState), (goals, ends.addState)):
        roots = np.flatnonzero(ways.before < 0)
        for number in (*draw.permutation(ways.out)[:EXITS], *roots):
            add(_state(curves, ways.pose[number]))
    setup.setGoal(ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(config.step)
    setup.setPlanner(planner)
    stop = base.PlannerTerminationCondition(lambda: count.left <= 0)
    count.left = config.max_tests
    setup.solve(stop)
    if not setup.haveExactSolutionPath():
        return None
    found = np.array([*map(_pose, setup.getSolutionPath().getStates())])
    way = starts.way(found[0])[::-1], found[1:-1], goals.way(found[-1])
    states = [_state(curves, pose) for pose in np.concatenate(way)]
    whole = _points(curves, states)
    # A shortened path is checked at the end, whatever is left.
    count.left, count.searches = config.shorten_tests, False
    path = geometric.PathGeometric(information, states)
    geometric.PathSimplifier(information).simplify(path, stop)
    short = _points(curves, path.getStates())
    # OMPL hands a shortened path out that touches obstacles, with a warning.
    free = [x for x in (short, whole) if space.is_free(x).all()]
    paths = [path for points in free if (path := make_path(points, car))]
    return min(paths, key=lambda path: path.duration, default=None)


def _state(curves: Any, pose: np.ndarray) -> Any:
    state = curves.allocState()
    state.setXY(float(pose[0]), float(pose[1]))
    state.setYaw(_wrap(float(pose[2])))
    return state


def _points(curves: Any, states: list[Any]) -> np.ndarray:
    """Poses (n, 3) of the rear axle along the curves between states."""
    points, state = [_pose(states[0])], curves.allocState()
    for first, last in itertools.pairwise(states):
        count = max(1, math.ceil(curves.distance(first, last) / STEP))
        for number in range(1, count + 1):
            curves.interpolate(first, last, number / count, state)
            points.append(_pose(state))
    return np.array(points)


def _pose(state: Any) -> tuple[float, float, float]:
    return state.getX(), state.getY(), state.getYaw()


STARTS = 4  # spawn regions tried for a bay, the nearest first
AROUND = 15.0  # m beyond start and bay in which a path may lie
SEARCH = SearchConfig(clearances=(0.05, 0.02), paths=2)


def unreached(
    layout: Layout, car: VehicleParameters, count: int, seed: int = 0
) -> tuple[list[int], list[int]]:
    """Plans paths to some bays while every other one holds a car of the same size.

    A path begins in one of the spawn regions nearest to the bay, at the place there
    that is nearest to it. The search is random, so a bay may be missed that has a path.

    Args:
        layout: no batch dimension.
        car: that drives.
        count: number of bays, drawn at random if there are more.
        seed: of the draw and of the searches.

    Returns:
        Indices of the bays that were tried, and of those without a path.
    """
    require_packages("ompl", "shapely")
    bays = np.asarray(layout.bay_pose, float)
    ends = np.asarray(layout.bay_mask & (layout.bay_kind != BayKind.EXIT))
    tried = np.random.default_rng(seed).permutation(np.flatnonzero(ends))[:count]
    walls, discs = np.asarray(layout.wall_mask), np.asarray(layout.disc_mask)
    solids = Solids(
        np.asarray(layout.wall_pose, float)[walls],
        np.asarray(layout.wall_size, float)[walls],
        np.asarray(layout.disc_centre, float)[discs],
        np.asarray(layout.disc_radius, float)[discs],
    )
    missed = []
    for bay in np.sort(tried).tolist():
        others = ends & (np.arange(len(bays)) != bay)
        size = np.tile((car.length, car.width), (int(others.sum()), 1))
        blocked = solids.with_boxes(bays[others], size)
        if not any(
            _has_path(layout, blocked, start, bay, car, (seed, bay, number))
            for number, start in enumerate(_starts(layout, bays[bay, :2]))
        ):
            missed.append(bay)
    return np.sort(tried).tolist(), missed


def _starts(layout: Layout, xy: np.ndarray) -> np.ndarray:
    """Poses (n, 3) in the nearest spawn regions, as near to a place as they allow."""
    mask = np.asarray(layout.spawn_mask)
    pose = np.asarray(layout.spawn_pose, float)[mask]
    half = np.asarray(layout.spawn_size, float)[mask] / 2
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    dx, dy = (xy - pose[:, :2]).T
    along = np.clip(cosine * dx + sine * dy, -half[:, 0], half[:, 0])
    aside = np.clip(cosine * dy - sine * dx, -half[:, 1], half[:, 1])
    pose[:, 0] += cosine * along - sine * aside
    pose[:, 1] += sine * along + cosine * aside
    nearest = np.argsort(np.hypot(*(pose[:, :2] - xy).T), kind="stable")
    return pose[nearest[:STARTS]]


def _has_path(
    layout: Layout,
    solids: Solids,
    start: np.ndarray,
    bay: int,
    car: VehicleParameters,
    seed: tuple[int, ...],
) -> bool:
    """Whether the planner finds a path in the part of the lot around both ends."""
    goal, extent = np.asarray(layout.bay_pose, float)[bay], np.asarray(layout.extent)
    ends = np.stack([start[:2], goal[:2]])
    low = np.maximum(ends.min(axis=0) - AROUND, -extent)
    high = np.minimum(ends.max(axis=0) + AROUND, extent)
    middle = np.array([*(low + high) / 2, 0.0])
    near = solids._replace(pose=solids.pose - middle, centre=solids.centre - middle[:2])
    one_way = layout.one_way is not None and layout.one_way[bay]
    goal, half = (goal - middle)[None] if one_way else goal - middle, (high - low) / 2
    return search(start - middle, goal, near, car, half, seed, SEARCH).path is not None
