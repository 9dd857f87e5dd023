"""Paths by OMPL: RRT-Connect in the space of Reeds and Shepp, shortened.

RRT-Connect (Kuffner and LaValle, ICRA 2000) grows a tree from the start and one from
the goal; Sucan, Moll and Kavraki, *The Open Motion Planning Library*, 2012. Its steps
are short, because in a tight bay only short moves are free, and it restarts when it
takes long. It mostly ends in the first of its goals, so the two ways round in the bay
take turns. Of a few paths the quickest to drive is taken; more are searched for if all
are slow. The number of collision tests ends a search, not time.
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
from carpark_mj.planning.paths import STEP, PlannedPath, centre, make_path, rear_axle
from carpark_mj.vehicle import VehicleParameters

_CORNERS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2  # of a unit square


class Solids(NamedTuple):
    """Obstacles that do not move."""

    pose: np.ndarray  # (n, 3) centre poses of boxes
    size: np.ndarray  # (n, 2) length and width [m]
    centre: np.ndarray  # (m, 2) of discs
    radius: np.ndarray  # (m,) [m]

    def with_boxes(self, pose: np.ndarray, size: np.ndarray) -> "Solids":
        """These and more boxes (k, 3), (k, 2)."""
        return self._replace(
            pose=np.concatenate([self.pose, pose]),
            size=np.concatenate([self.size, size]),
        )


class FreeSpace:
    """The poses of a rectangle in a lot that are free of collisions."""

    def __init__(
        self, solids: Solids, size: tuple[float, float], extent: np.ndarray
    ) -> None:
        """For a rectangle [m] in a lot of half widths `extent` (2,) [m]."""
        import shapely  # comes with the planner's extra

        self.extent, self._shapely, self._corners = extent, shapely, _CORNERS * size
        pairs = zip(solids.pose, solids.size, strict=True)
        self._boxes = shapely.union_all([self._box(_CORNERS * b, *a) for a, b in pairs])
        self._discs, self._radius = shapely.points(solids.centre), solids.radius
        shapely.prepare(self._boxes)

    def _box(self, corners: np.ndarray, x: float, y: float, yaw: float) -> Any:
        cos, sin = math.cos(yaw), math.sin(yaw)
        return self._shapely.polygons(corners @ ((cos, sin), (-sin, cos)) + (x, y))

    def is_free(self, x: float, y: float, yaw: float) -> bool:
        """Whether the rectangle touches nothing, with its centre within the extent."""
        if abs(x) > self.extent[0] or abs(y) > self.extent[1]:
            return False
        car = self._box(self._corners, x, y, yaw)
        if self._shapely.intersects(self._boxes, car):
            return False
        if not len(self._radius):
            return True
        return bool((self._shapely.distance(self._discs, car) >= self._radius).all())


@dataclasses.dataclass(frozen=True)
class SearchConfig:
    """How paths are searched."""

    # distances to keep from obstacles [m]; the first that leads to a path counts
    clearances: tuple[float, ...] = (0.08, 0.05, 0.02)
    # share of the full lock that is left to the tracking controller
    spare_steering: float = 0.05
    step: float = 0.3  # longest extension of a tree [m]
    paths: int = 4  # how many paths are searched for, at each clearance
    # how many more, at most, while the quickest takes longer than `slow`
    more_paths: int = 12
    slow: float = 70.0  # [s]
    max_tests: int = 8_000  # collision tests of a search, after which it is given up
    shorten_tests: int = 3_000  # collision tests that shorten a path
    resolution: float = 0.05  # distance between tested poses [m]


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
    most = config.paths + config.more_paths
    seeds = np.random.SeedSequence(seed).generate_state(most).tolist()
    poses = _poses_in_bay(goal)
    for clearance in config.clearances:
        size = car.length + 2 * clearance, car.width + 2 * clearance
        space = FreeSpace(solids, size, extent)
        if not (space.is_free(*start) and space.is_free(*np.atleast_2d(goal)[0])):
            continue
        here = rear_axle(car, start)
        ends = rear_axle(car, poses), rear_axle(car, poses[::-1])
        best: PlannedPath | None = None
        for number, own_seed in enumerate(seeds):
            path = _connect(here, ends[number % 2], space, car, config, own_seed)
            if path and (best is None or path.duration < best.duration):
                best = path
            is_slow = best is not None and best.duration > config.slow
            if number + 1 >= config.paths and not is_slow:
                break
        if best is not None:
            return Search(best, time.thread_time() - begun, clearance)
    return Search(None, time.thread_time() - begun, math.nan)


def _poses_in_bay(goal: np.ndarray) -> np.ndarray:
    """Poses in a bay (n, 3), nose in and nose out, in the same order for both."""
    if goal.ndim == 2:
        return np.array([[*pose[:2], _wrap(pose[2])] for pose in goal])
    turned = ([*goal[:2], _wrap(goal[2] + turn)] for turn in (0.0, math.pi))
    return np.array(sorted(turned))


def _wrap(yaw: float) -> float:
    """The direction in [-pi, pi): OMPL leaves out states beyond its bounds."""
    yaw = math.remainder(yaw, 2 * math.pi)
    return -math.pi if yaw == math.pi else yaw


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
    start: np.ndarray,
    goals: np.ndarray,
    space: FreeSpace,
    car: VehicleParameters,
    config: SearchConfig,
    seed: int,
) -> PlannedPath | None:
    """One search and its path from (3,) to goals (n, 3) of the rear axle, or None."""
    base, geometric, util = _ompl()
    util.RNG.setSeed(max(seed, 1))  # 0 is none
    lock = car.max_steering * (1.0 - config.spare_steering)
    curves = base.ReedsSheppStateSpace(car.wheelbase / math.tan(lock))
    bounds = base.RealVectorBounds(2)
    for axis, half in enumerate(space.extent.tolist()):
        bounds.setLow(axis, -half)
        bounds.setHigh(axis, half)
    curves.setBounds(bounds)
    curves.setLongestValidSegmentFraction(config.resolution / curves.getMaximumExtent())

    def is_free(state: Any) -> bool:
        (x, y, yaw), offset = _pose(state), car.centre_offset
        return space.is_free(
            x + offset * math.cos(yaw), y + offset * math.sin(yaw), yaw
        )

    count = _Counter(is_free)
    setup = geometric.SimpleSetup(curves)
    setup.setStateValidityChecker(count)
    information = setup.getSpaceInformation()
    ends = base.GoalStates(information)
    setup.addStartState(_state(curves, start))
    for goal in goals:
        ends.addState(_state(curves, goal))
    setup.setGoal(ends)
    planner = geometric.RRTConnect(information)
    planner.setRange(config.step)
    setup.setPlanner(planner)
    stop = base.PlannerTerminationCondition(lambda: count.left <= 0)
    count.left = config.max_tests
    setup.solve(stop)
    if not setup.haveExactSolutionPath():
        return None
    whole = _points(curves, setup.getSolutionPath().getStates())
    # A shortened path is checked at the end, whatever is left.
    count.left, count.searches = config.shorten_tests, False
    setup.simplifySolution(stop)
    short = _points(curves, setup.getSolutionPath().getStates())
    # OMPL hands a shortened path out that touches obstacles, with a warning.
    for points in (short, whole):
        if all(space.is_free(*place) for place in centre(car, points)):
            return make_path(points, car)
    return None


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
SEARCH = SearchConfig(clearances=(0.05, 0.02), paths=2, more_paths=0)


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
