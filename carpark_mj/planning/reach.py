"""Bays of a lot that the planner finds no path to."""

import math

import numpy as np

from carpark_mj.layouts.types import BayKind, Layout
from carpark_mj.planning.obstacles import Solids
from carpark_mj.planning.search import SearchConfig, require_ompl, search
from carpark_mj.vehicle import VehicleParameters

STARTS = 4  # spawn regions tried for a bay, the nearest first
AROUND = 15.0  # m beyond start and bay in which a path may lie
SEARCH = SearchConfig(clearances=(0.05, 0.02), paths=2, more_paths=0)


def unreached(
    layout: Layout, car: VehicleParameters, count: int, seed: int = 0
) -> tuple[list[int], list[int]]:
    """Plans paths to some bays while every other one holds a parked car.

    A path begins in one of the spawn regions nearest to the bay, at the place there
    that is nearest to it. The search is random, so a bay may be missed that has a path.

    Args:
        layout: no batch dimension.
        car: that drives; the parked cars are of its size.
        count: number of bays, drawn at random if there are more.
        seed: of the draw and of the searches.

    Returns:
        Indices of the bays that were tried, and of those without a path.

    Raises:
        ValueError: OMPL is not installed.
    """
    require_ompl()
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
    found = pose.copy()
    found[:, 0] += cosine * along - sine * aside
    found[:, 1] += sine * along + cosine * aside
    nearest = np.argsort(np.hypot(*(found[:, :2] - xy).T), kind="stable")
    return found[nearest[:STARTS]]


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
    reach = math.hypot(*(high - low)) / 2
    wide = np.hypot(*solids.size.T) / 2
    boxes = np.hypot(*(solids.pose - middle)[:, :2].T) < reach + wide
    discs = np.hypot(*(solids.centre - middle[:2]).T) < reach + solids.radius
    near = Solids(
        solids.pose[boxes] - middle,
        solids.size[boxes],
        solids.centre[discs] - middle[:2],
        solids.radius[discs],
    )
    goal = goal - middle
    if layout.one_way is not None and layout.one_way[bay]:
        goal = goal[None]
    half = (high - low) / 2
    return search(start - middle, goal, near, car, half, seed, SEARCH).path is not None
