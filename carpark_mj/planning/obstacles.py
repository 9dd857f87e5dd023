"""Collision tests of a car with solid boxes and discs, by shapely."""

from typing import Any, NamedTuple

import numpy as np

_CORNERS = np.array([1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j]) / 2  # of a unit square
_ARCS = 128  # edges of a quarter of a disc's outline, outside it by 2e-5 of its radius


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
        self, solids: Solids, size: Any, extent: np.ndarray, ahead: float = 0.0
    ) -> None:
        """For a rectangle (2,) [m] in a lot of half widths `extent` (2,) [m].

        Its middle is `ahead` [m] of its pose.
        """
        import shapely  # comes with the planner's extra

        self._shapely, self.extent = shapely, extent
        boxes = self._boxes(solids.pose, _corners(solids.size))
        outside = solids.radius / np.cos(np.pi / (4 * _ARCS))
        discs = shapely.buffer(shapely.points(solids.centre), outside, quad_segs=_ARCS)
        self._solid = shapely.union_all([*boxes, *discs])
        shapely.prepare(self._solid)
        self._corners = _corners(np.asarray(size)) + ahead

    def _boxes(self, pose: np.ndarray, corners: np.ndarray) -> Any:
        """Polygons (...) at poses (..., 3), of corners (..., 4) as complex numbers."""
        corners = corners * np.exp(1j * pose[..., 2:])
        corners += pose[..., :1] + 1j * pose[..., 1:2]
        return self._shapely.polygons(corners[..., None].view(float))

    def is_free(self, pose: np.ndarray) -> Any:
        """(...) bool, whether rectangles (..., 3) touch nothing and are in the lot."""
        inside = (np.abs(pose[..., :2]) <= self.extent).all(axis=-1)
        cars = self._boxes(pose, self._corners)
        return inside & ~self._shapely.intersects(self._solid, cars)

    def room(self, pose: np.ndarray) -> Any:
        """(...) distances of rectangles (..., 3) from obstacles [m]."""
        cars = self._boxes(pose, self._corners)
        return np.fmin(self._shapely.distance(self._solid, cars), np.inf)


def _corners(size: np.ndarray) -> np.ndarray:
    """Corners (..., 4) of boxes (..., 2) about the origin."""
    return _CORNERS.real * size[..., :1] + 1j * _CORNERS.imag * size[..., 1:]
