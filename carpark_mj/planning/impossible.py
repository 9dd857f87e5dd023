"""Agents that certainly cannot park, whatever all cars of their lot do.

A necessary test: a disc as wide as each car moves among the cells of a grid, alone and
with that of every other car. A cell counts as free where any point of it may be, so
that discs pass wherever cars do; cars may still fail where discs pass.
"""

import heapq
import itertools
import math
from collections.abc import Sequence

import numpy as np

from carpark_mj.planning.driving import Sight
from carpark_mj.planning.obstacles import Solids

CELL = 0.4  # m
STEPS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])


def impossible(sights: Sequence[Sight]) -> np.ndarray:
    """(agents,) bool, who cannot reach the goal alone, or only if another does not.

    Args:
        sights: what the agents of a lot see.
    """
    discs = [_Disc(sight) for sight in sights]
    never = np.array([not disc.reaches for disc in discs], bool)
    for a, b in itertools.combinations(np.flatnonzero(~never), 2):
        if not _both_reach(discs[a], discs[b]):
            never[[a, b]] = True
    return never


class _Disc:
    """The cells where the middle of a car may be.

    Attributes:
        radius: of the disc [m].
        centre: (n, 2) of cells [m].
        beside: of each cell, indices of the free ones next to it.
        left: (n,) steps from each to the goal; inf where it cannot be reached.
        start: index of the cell; None if it is not free.
    """

    def __init__(self, sight: Sight) -> None:
        self.radius = sight.car.width / 2
        counts = np.ceil(2 * sight.extent / CELL).astype(int)
        grid = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
        centre = (grid + 0.5) * CELL - sight.extent
        free = _gap(sight.solids, centre) > self.radius - CELL * np.sqrt(0.5)
        self.centre, cells = centre[free], list(map(tuple, grid[free].tolist()))
        index = {cell: number for number, cell in enumerate(cells)}
        self.beside = [
            [
                index[x, y]
                for x, y in (np.array(cell) + STEPS).tolist()
                if (x, y) in index
            ]
            for cell in cells
        ]

        def at(point: np.ndarray) -> int | None:
            x, y = ((point + sight.extent) // CELL).astype(int).tolist()
            return index.get((x, y))

        self.start = at(sight.pose[:2])
        self.left = self._steps_to(at(np.atleast_2d(sight.goal)[0, :2]))

    @property
    def reaches(self) -> bool:
        """Whether the disc gets from start to goal."""
        return self.start is not None and self.left[self.start] < np.inf

    def _steps_to(self, goal: int | None) -> list[float]:
        left = [np.inf] * len(self.centre)
        edge, steps = [] if goal is None else [goal], 0
        while edge:
            for cell in edge:
                left[cell] = steps
            onward = {near for cell in edge for near in self.beside[cell]}
            edge = [cell for cell in onward if left[cell] == np.inf]
            steps += 1
        return left


def _both_reach(a: _Disc, b: _Disc) -> bool:
    """Whether two discs get to their goals without touching each other."""
    here, there, apart = a.centre.tolist(), b.centre.tolist(), a.radius + b.radius
    assert a.start is not None
    assert b.start is not None
    edge = [(a.left[a.start] + b.left[b.start], a.start, b.start)]
    reached = {(a.start, b.start)}
    while edge:  # nearest to both goals first
        left, one, two = heapq.heappop(edge)
        if left == 0:
            return True
        moves = [(near, two) for near in a.beside[one]]
        for cells in moves + [(one, near) for near in b.beside[two]]:
            (x, y), (u, v) = here[cells[0]], there[cells[1]]
            # The farthest that points of the two cells can be from each other.
            gap = math.hypot(abs(x - u) + CELL, abs(y - v) + CELL)
            if cells not in reached and gap > apart:
                reached.add(cells)
                left = a.left[cells[0]] + b.left[cells[1]]
                heapq.heappush(edge, (left, *cells))
    return False


def _gap(solids: Solids, point: np.ndarray) -> np.ndarray:
    """Distances (...) of points (..., 2) to the nearest obstacle [m]."""
    least = np.full(point.shape[:-1], np.inf)
    for (x, y, yaw), size in zip(solids.pose, solids.size, strict=True):
        dx, dy = point[..., 0] - x, point[..., 1] - y
        along = np.abs(np.cos(yaw) * dx + np.sin(yaw) * dy) - size[0] / 2
        across = np.abs(np.cos(yaw) * dy - np.sin(yaw) * dx) - size[1] / 2
        gap = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
        least = np.minimum(least, gap)
    for (x, y), radius in zip(solids.centre, solids.radius, strict=True):
        distance = np.hypot(point[..., 0] - x, point[..., 1] - y)
        least = np.minimum(least, distance - radius)
    return least
