"""Agents that certainly cannot park, whatever all cars of their lot do.

A necessary test: a disc as wide as each car moves among the cells of a grid, alone and
with that of every other car. A cell counts as free where any point of it may be, so
that discs pass wherever cars do; cars may still fail where discs pass.
"""

import itertools
from collections.abc import Callable, Sequence

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
    discs = [_Cells(sight) for sight in sights]
    never = np.array([not disc.reaches() for disc in discs])
    for a, b in itertools.combinations(np.flatnonzero(~never), 2):
        if not _both_reach(discs[a], discs[b]):
            never[[a, b]] = True
    return never


class _Cells:
    """The cells where the middle of a car may be.

    Attributes:
        radius: of the disc [m].
        centre: (n, 2) of cells [m].
        beside: (n, 4) index of the cells next to each; n = none.
        start: index of the cell; n = none.
        goal: the same.
    """

    def __init__(self, sight: Sight) -> None:
        self.radius = sight.car.width / 2
        counts = np.ceil(2 * sight.extent / CELL).astype(int)
        grid = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
        centre = (grid + 0.5) * CELL - sight.extent
        free = _gap(sight.solids, centre) > self.radius - CELL * np.sqrt(0.5)
        self.centre, count = centre[free], int(free.sum())
        index = np.full(counts + 2, count)  # a border that is not free
        index[1:-1, 1:-1][free] = np.arange(count)
        cells = grid[free] + 1
        self.beside = index[tuple(np.moveaxis(cells[:, None] + STEPS, -1, 0))]

        def cell(point: np.ndarray) -> int:
            return int(index[tuple(((point + sight.extent) // CELL).astype(int) + 1)])

        self.start = cell(sight.pose[:2])
        self.goal = cell(np.atleast_2d(sight.goal)[0, :2])

    def reaches(self) -> bool:
        """Whether the disc gets from start to goal."""
        count = len(self.centre)
        if count in (self.start, self.goal):
            return False
        free = np.ones(count, bool)
        return _flood(free, self.start, self.goal, lambda at: self.beside[at].T)


def _both_reach(a: _Cells, b: _Cells) -> bool:
    """Whether two discs get to their goals without touching each other."""
    count, other = len(a.centre), len(b.centre)
    # The farthest that points of two cells can be from each other.
    gap = np.abs(a.centre[:, None] - b.centre) + CELL
    free = (np.hypot(gap[..., 0], gap[..., 1]) > a.radius + b.radius).ravel()

    def beside(at: np.ndarray) -> np.ndarray:
        rows, columns = np.divmod(at, other)
        one, two = a.beside[rows].T, b.beside[columns].T
        moved = np.where(one < count, one * other + columns, len(free))
        return np.concatenate(
            [moved, np.where(two < other, rows * other + two, len(free))]
        )

    return _flood(free, a.start * other + b.start, a.goal * other + b.goal, beside)


def _flood(
    free: np.ndarray,
    start: int,
    goal: int,
    beside: Callable[[np.ndarray], np.ndarray],
) -> bool:
    """Whether free (n,) places from one to another lie next to each other."""
    left = np.append(free, False)  # the last stands for none
    edge = np.array([start])
    while len(edge):
        left[edge] = False
        if not left[goal]:
            return True
        edge = beside(edge).ravel()
        edge = np.unique(edge[left[edge]])
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
        least = np.minimum(
            least, np.hypot(point[..., 0] - x, point[..., 1] - y) - radius
        )
    return least
