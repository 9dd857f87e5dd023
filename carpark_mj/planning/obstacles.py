"""Solid boxes and discs, and whether a car stands free of them; NumPy, one pose a call.

The test is exact, as `carpark_mj.geometry.boxes_overlap`, which is for batches. A grid
of distances to the nearest obstacle answers most calls before it.
"""

import math
from typing import NamedTuple

import numpy as np

CELL = 0.2  # m, spacing of the grid


class Solids(NamedTuple):
    """What cars can hit.

    Attributes:
        pose: (n, 3) centre poses of boxes.
        size: (n, 2) length and width [m].
        centre: (m, 2) of discs.
        radius: (m,) [m].
    """

    pose: np.ndarray
    size: np.ndarray
    centre: np.ndarray
    radius: np.ndarray

    def with_boxes(self, pose: np.ndarray, size: np.ndarray) -> "Solids":
        """These and more boxes (k, 3), (k, 2)."""
        return self._replace(
            pose=np.concatenate([self.pose, pose]),
            size=np.concatenate([self.size, size]),
        )


class FreeSpace:
    """Where a rectangle can stand in a lot.

    Attributes:
        extent: half widths (2,) of the lot about the origin [m].
    """

    def __init__(
        self,
        solids: Solids,
        size: tuple[float, float],
        extent: np.ndarray,
        grid: bool = True,
    ) -> None:
        """Prepares the test for a rectangle of this length and width [m].

        A grid takes some milliseconds, and pays for more than some hundred tests.
        """
        self.extent = extent
        self._half = size[0] / 2, size[1] / 2
        self._x, self._y, yaw = solids.pose.T
        self._yaw, self._cos, self._sin = yaw, np.cos(yaw), np.sin(yaw)
        self._half_x, self._half_y = solids.size.T / 2
        self._disc, self._radius = solids.centre, solids.radius
        # Any point of a cell is so near to the cell's middle.
        slack = CELL * math.sqrt(0.5)
        self._far = math.hypot(*self._half) + slack
        self._near = min(self._half) - slack
        self._counts = tuple(math.ceil(2 * half / CELL) for half in extent)
        self._grid = self._distances().tolist() if grid else None

    def _distances(self) -> np.ndarray:
        """Distances [m] from the middles of cells to the nearest obstacle."""
        x, y = (
            CELL * (np.arange(count) + 0.5) - half
            for count, half in zip(self._counts, self.extent, strict=True)
        )
        x, y = x[:, None], y[None]
        nearest = np.full(self._counts, np.inf)
        for row in range(len(self._x)):
            cos, sin = self._cos[row], self._sin[row]
            dx, dy = x - self._x[row], y - self._y[row]
            along = np.abs(cos * dx + sin * dy) - self._half_x[row]
            across = np.abs(cos * dy - sin * dx) - self._half_y[row]
            gap = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
            nearest = np.minimum(nearest, gap)
        for (cx, cy), radius in zip(self._disc, self._radius, strict=True):
            gap = np.maximum(np.hypot(x - cx, y - cy) - radius, 0.0)
            nearest = np.minimum(nearest, gap)
        return nearest

    def is_free(self, x: float, y: float, yaw: float) -> bool:
        """Whether the rectangle with this centre lies in the lot and touches nothing.

        Its centre must be within the extent; it may reach beyond.
        """
        column = math.floor((x + self.extent[0]) / CELL)
        row = math.floor((y + self.extent[1]) / CELL)
        if not (0 <= column < self._counts[0] and 0 <= row < self._counts[1]):
            return False
        if self._grid is None:
            return self._test(x, y, yaw)
        distance = self._grid[column][row]
        if distance > self._far:
            return True
        return distance >= self._near and self._test(x, y, yaw)

    def _test(self, x: float, y: float, yaw: float) -> bool:
        """The separating axis theorem against all boxes, and all discs."""
        half_x, half_y = self._half
        cos, sin = math.cos(yaw), math.sin(yaw)
        dx, dy = self._x - x, self._y - y
        turn = self._yaw - yaw
        c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        apart = np.abs(cos * dx + sin * dy) >= half_x + self._half_x * c + (
            self._half_y * s
        )
        apart |= np.abs(cos * dy - sin * dx) >= half_y + self._half_x * s + (
            self._half_y * c
        )
        apart |= np.abs(self._cos * dx + self._sin * dy) >= (
            self._half_x + half_x * c + half_y * s
        )
        apart |= np.abs(self._cos * dy - self._sin * dx) >= (
            self._half_y + half_x * s + half_y * c
        )
        if not apart.all():
            return False
        if not len(self._radius):
            return True
        dx, dy = self._disc[:, 0] - x, self._disc[:, 1] - y
        along = np.maximum(np.abs(cos * dx + sin * dy) - half_x, 0.0)
        across = np.maximum(np.abs(cos * dy - sin * dx) - half_y, 0.0)
        return bool((np.hypot(along, across) >= self._radius).all())
