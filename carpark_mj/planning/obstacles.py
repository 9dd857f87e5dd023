"""Collision tests of a car with solid boxes and discs, one pose a call.

The test is exact, like `carpark_mj.geometry.boxes_overlap` for batches. A grid gives
the near obstacles: often none, or one that is too near for any heading. The few others
are tested on plain numbers, because NumPy takes longer to call than to compute.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

CELL = 0.2  # m, spacing of the grid


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


def gaps(solids: Solids, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distances (..., n + m) of points to every box, then every disc [m]; 0 inside."""
    found = []
    for (x_box, y_box, yaw), size in zip(solids.pose, solids.size, strict=True):
        dx, dy, cos, sin = x - x_box, y - y_box, np.cos(yaw), np.sin(yaw)
        along = np.abs(cos * dx + sin * dy) - size[0] / 2
        across = np.abs(cos * dy - sin * dx) - size[1] / 2
        found.append(np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)))
    for (x_disc, y_disc), radius in zip(solids.centre, solids.radius, strict=True):
        found.append(np.maximum(np.hypot(x - x_disc, y - y_disc) - radius, 0.0))
    shape = np.broadcast_shapes(x.shape, y.shape)
    return np.stack(found, axis=-1) if found else np.zeros((*shape, 0))


class _Box(NamedTuple):
    x: float
    y: float
    cos: float
    sin: float
    half_x: float
    half_y: float


class _Near(NamedTuple):
    """Obstacles that a rectangle may touch: boxes, and discs (x, y, radius)."""

    boxes: list[_Box]
    discs: list[list[float]]


class FreeSpace:
    """The poses of a rectangle in a lot that are free of collisions."""

    def __init__(
        self,
        solids: Solids,
        size: tuple[float, float],
        extent: np.ndarray,
        grid: bool = True,
    ) -> None:
        """For a rectangle [m]; a grid pays for more than some hundred tests."""
        self.extent = extent  # half widths (2,) of the lot about the origin [m]
        self._half = size[0] / 2, size[1] / 2
        x, y, yaw = solids.pose.T
        boxes = np.column_stack([x, y, np.cos(yaw), np.sin(yaw), solids.size / 2])
        discs = np.column_stack([solids.centre, solids.radius])
        self._boxes = [_Box(*row) for row in boxes.tolist()]
        self._discs: list[list[float]] = discs.tolist()
        self._counts = tuple(math.ceil(2 * half / CELL) for half in extent)
        self._near: dict[tuple[int, int], _Near | None] = {}
        self._distance: np.ndarray | None = None
        if grid:  # from the middles of cells
            x, y = (
                CELL * (np.arange(count) + 0.5) - half
                for count, half in zip(self._counts, extent, strict=True)
            )
            self._distance = gaps(solids, x[:, None], y[None])

    def _obstacles(self, column: int, row: int) -> _Near | None:
        """Obstacles that a rectangle centred in a cell may touch; None if it must."""
        if self._distance is None:
            return _Near(self._boxes, self._discs)
        # Any point of a cell is so near to the cell's middle.
        slack = CELL * math.sqrt(0.5)
        distance = self._distance[column, row]
        if (distance < min(self._half) - slack).any():
            return None
        near = (distance <= math.hypot(*self._half) + slack).tolist()
        boxes = itertools.compress(self._boxes, near)
        discs = itertools.compress(self._discs, near[len(self._boxes) :])
        return _Near(list(boxes), list(discs))

    def is_free(self, x: float, y: float, yaw: float) -> bool:
        """Whether the rectangle touches nothing, with its centre within the extent."""
        column = math.floor((x + self.extent[0]) / CELL)
        row = math.floor((y + self.extent[1]) / CELL)
        cell = column, row
        if cell not in self._near:
            if not (0 <= column < self._counts[0] and 0 <= row < self._counts[1]):
                return False
            self._near[cell] = self._obstacles(column, row)
        near = self._near[cell]
        return near is not None and self._test(near, x, y, yaw)

    def _test(self, near: _Near, x: float, y: float, yaw: float) -> bool:
        """The separating axis theorem against boxes, and discs."""
        half_x, half_y = self._half
        cos, sin = math.cos(yaw), math.sin(yaw)
        for box in near.boxes:
            dx, dy = box.x - x, box.y - y
            c = abs(box.cos * cos + box.sin * sin)
            s = abs(box.sin * cos - box.cos * sin)
            x_box, y_box = box.cos * dx + box.sin * dy, box.cos * dy - box.sin * dx
            if not (
                abs(cos * dx + sin * dy) >= half_x + box.half_x * c + box.half_y * s
                or abs(cos * dy - sin * dx) >= half_y + box.half_x * s + box.half_y * c
                or abs(x_box) >= box.half_x + half_x * c + half_y * s
                or abs(y_box) >= box.half_y + half_x * s + half_y * c
            ):
                return False
        for disc_x, disc_y, radius in near.discs:
            dx, dy = disc_x - x, disc_y - y
            along = max(abs(cos * dx + sin * dy) - half_x, 0.0)
            across = max(abs(cos * dy - sin * dx) - half_y, 0.0)
            if math.hypot(along, across) < radius:
                return False
        return True
