"""Collision tests of a car with solid boxes and discs, one pose a call, by shapely."""

import math
from typing import Any, NamedTuple

import numpy as np

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
