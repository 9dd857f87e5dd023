"""Rectangles that fit polygons, and rectangles cut until they are free."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import shapely
from shapely import affinity, ops

SLACK = 0.5  # m by which the rectangle of a wall may be thicker than the wall
EPSILON = 1e-4  # m by which a cut reaches beyond the polygon
DEEPEST = 16  # cuts of one polygon within each other
MOST_CORNERS = 150  # of a polygon that is cut at its corners, each of which is tried
REFLEX = math.radians(5.0)  # beyond 180 deg, of a corner worth a cut


@dataclasses.dataclass(frozen=True)
class Box:
    """A rectangle: centre, heading of its length [rad], length and width [m]."""

    x: float
    y: float
    yaw: float
    length: float
    width: float

    @property
    def pose(self) -> tuple[float, float, float]:
        """Centre and heading."""
        return self.x, self.y, self.yaw

    @property
    def size(self) -> tuple[float, float]:
        """Length and width."""
        return self.length, self.width

    @property
    def shape(self) -> Any:
        """As a shapely polygon."""
        box = shapely.box(
            -self.length / 2, -self.width / 2, self.length / 2, self.width / 2
        )
        turned = affinity.rotate(box, self.yaw, origin=(0, 0), use_radians=True)
        return affinity.translate(turned, self.x, self.y)

    def turned(self) -> "Box":
        """The same rectangle, heading the other way."""
        return dataclasses.replace(
            self, yaw=math.remainder(self.yaw + math.pi, math.tau)
        )

    def local(self, shape: Any) -> Any:
        """A shape in the rectangle's own frame."""
        moved = affinity.translate(shape, -self.x, -self.y)
        return affinity.rotate(moved, -self.yaw, origin=(0, 0), use_radians=True)

    def part(self, back: float, front: float, right: float, left: float) -> "Box":
        """The part within these coordinates of the rectangle's own frame."""
        along, aside = (back + front) / 2, (right + left) / 2
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        return Box(
            self.x + along * cosine - aside * sine,
            self.y + along * sine + aside * cosine,
            self.yaw,
            front - back,
            left - right,
        )


def around(polygon: Any) -> Box:
    """The smallest rectangle around a polygon, its length the longer side."""
    hull = shapely.minimum_rotated_rectangle(polygon)
    corners = np.asarray(hull.exterior.coords)
    first, second = corners[1] - corners[0], corners[2] - corners[1]
    length, width = np.hypot(*first), np.hypot(*second)
    ahead = first
    if width > length:
        length, width, ahead = width, length, second
    x, y = hull.centroid.coords[0]
    yaw = math.atan2(ahead[1], ahead[0])
    return Box(x, y, yaw, float(length), float(width))


def best_fit(polygon: Any) -> tuple[Box, float]:
    """The rectangle of a polygon's own area, and how far their outlines differ [m].

    It has the centre and the directions of the smallest rectangle around the polygon,
    shrunk alike on all sides.
    """
    box = around(polygon)
    scale = math.sqrt(polygon.area / max(box.length * box.width, 1e-12))
    box = dataclasses.replace(
        box,
        x=polygon.centroid.x,
        y=polygon.centroid.y,
        length=box.length * scale,
        width=box.width * scale,
    )
    return box, float(shapely.hausdorff_distance(polygon, box.shape))


def boxes(polygon: Any, depth: int = 0) -> Iterator[Box]:
    """Rectangles that cover a polygon and reach at most `SLACK` beyond it.

    It is cut where it has a hole or a reflex corner, and else across its length, as
    long as it has many corners too.
    """
    if polygon.geom_type != "Polygon":
        for part in getattr(polygon, "geoms", ()):
            yield from boxes(part, depth)
        return
    if polygon.area < 1e-4:
        return
    box = around(polygon)
    beyond = box.shape.difference(polygon)
    if depth == DEEPEST or beyond.buffer(-SLACK / 2).is_empty:
        yield box
        return
    across = _line(box.x, box.y, box.yaw + math.pi / 2, 2 * box.length, both=True)
    plain = shapely.get_num_coordinates(polygon) <= MOST_CORNERS
    for cut in (*(_cuts(polygon) if plain else ()), across):
        parts = ops.split(polygon, cut).geoms
        if len(parts) > 1:
            for part in parts:
                yield from boxes(part, depth + 1)
            return
    yield box


def _cuts(polygon: Any) -> Iterator[Any]:
    """The line through a hole, or else the shortest one from a reflex corner."""
    reach = 4 * polygon.length
    if polygon.interiors:
        hole = shapely.Polygon(polygon.interiors[0]).representative_point()
        yield _line(hole.x, hole.y, around(polygon).yaw + math.pi / 2, reach, both=True)
        return
    corners = np.asarray(shapely.orient_polygons(polygon).exterior.coords)[:-1]
    before, after = corners - np.roll(corners, 1, 0), np.roll(corners, -1, 0) - corners
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.arctan2(cross, (before * after).sum(axis=1))
    bisector = (
        before / np.hypot(*before.T)[:, None] - after / np.hypot(*after.T)[:, None]
    )
    found = []
    for corner in np.flatnonzero(turn < -REFLEX):
        x, y = corners[corner]
        for dx, dy in (before[corner], -after[corner], bisector[corner]):
            ray = _line(x, y, math.atan2(dy, dx), reach)
            inside = shapely.get_parts(ray.intersection(polygon))
            inside = inside[shapely.length(inside) > EPSILON]
            if len(inside):
                first = inside[
                    np.argmin(shapely.distance(inside, ray.boundary.geoms[0]))
                ]
                found.append((first.length, x, y, math.atan2(dy, dx)))
    if found:
        length, x, y, yaw = min(found)
        # From the corner itself: beside an edge it would not meet the polygon.
        yield _line(x, y, yaw, length + EPSILON)


def _line(x: float, y: float, yaw: float, reach: float, both: bool = False) -> Any:
    dx, dy = reach * math.cos(yaw), reach * math.sin(yaw)
    return shapely.LineString([(x - dx * both, y - dy * both), (x + dx, y + dy)])


def cut_free(box: Box, others: Iterable[Any], gap: float = 0.002) -> Box | None:
    """The rectangle less its overlap with other shapes; None if it vanishes.

    Each shape costs the side that loses the least area.

    Args:
        box: to cut.
        others: shapely polygons.
        gap: left between the rectangle and the shapes [m].
    """
    back, front = -box.length / 2, box.length / 2
    right, left = -box.width / 2, box.width / 2
    for other in others:
        rest = shapely.box(back, right, front, left)
        hit = box.local(other).intersection(rest)
        if hit.area < 1e-9:
            continue
        low_x, low_y, high_x, high_y = hit.bounds
        length, width = front - back, left - right
        loss = {
            "front": (front - low_x) * width,
            "back": (high_x - back) * width,
            "left": (left - low_y) * length,
            "right": (high_y - right) * length,
        }
        side = min(loss, key=lambda name: loss[name])
        if side == "front":
            front = low_x - gap
        elif side == "back":
            back = high_x + gap
        elif side == "left":
            left = low_y - gap
        else:
            right = high_y + gap
        if front <= back or left <= right:
            return None
    return box.part(back, front, right, left)
