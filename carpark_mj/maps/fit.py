"""Rectangles that fit polygons, and rectangles cut until they are free."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import shapely
from shapely import affinity, ops

STALL = 5.0  # m, length that a leaning spot shorter than its sides may have
CORNER = 0.15  # m by which a corner of a spot stands out
LEAN = 0.3  # cosine between sides (73 deg) below which a spot may be a rhombus ...
ALIKE = 0.75  # ... if its sides have at least this ratio
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


def parallelogram(polygon: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """The mean sides (2,) and (2,) [m] of a polygon of four corners, the longer first.

    Corners that stand out by less than `CORNER` do not count. None for other polygons.
    """
    ring = np.asarray(polygon.convex_hull.exterior.coords)[:-1]
    # The ring begins at a real corner, because its first point is always kept.
    start = np.hypot(*(ring - ring.mean(axis=0)).T).argmax()
    ring = np.roll(ring, -start, axis=0)
    ring = shapely.LinearRing(ring).simplify(CORNER)
    corners = np.asarray(ring.coords)[:-1]
    if len(corners) != 4:
        return None
    one, two = corners[1] - corners[0], corners[2] - corners[1]
    sides = (one + corners[2] - corners[3]) / 2, (two + corners[3] - corners[0]) / 2
    long, short = sorted(sides, key=lambda side: -float(np.hypot(*side)))
    return long, short


def leaning(centre: Any, along: np.ndarray, aside: np.ndarray) -> Any:
    """The parallelogram with a centre (2,) and two sides (2,) [m]."""
    corners = [
        np.asarray(centre) + (a * along + b * aside) / 2
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return shapely.Polygon(corners)


def best_fits(polygon: Any) -> list[tuple[Box, float]]:
    """Rectangles of a spot, the likeliest first, and the errors of their outlines [m].

    The rectangle of a spot with four corners lies between its long sides, around its
    centre. Where the spot leans, the rectangle is the longest one within it, or as long
    as the sides but at most `STALL` if that is longer. If the spot leans so much that
    both pairs of sides may be those of a car's length, there are two rectangles. Any
    other polygon has the rectangle of its own area in the directions of the smallest
    one around it.

    The error is the distance to the best parallelogram, or else to the rectangle.
    """
    centre = polygon.centroid.coords[0]
    if sides := parallelogram(polygon):
        error = shapely.hausdorff_distance(polygon, leaning(centre, *sides))
        found = [_between(centre, *sides)]
        long, short = (float(np.hypot(*side)) for side in sides)
        lean = abs(float(sides[0] @ sides[1])) / (long * short)
        if lean > LEAN and short > ALIKE * long:
            found.append(_between(centre, *sides[::-1]))
        return [(box, float(error)) for box in found]
    box = around(polygon)
    scale = math.sqrt(polygon.area / max(box.length * box.width, 1e-12))
    x, y = centre
    box = Box(x, y, box.yaw, box.length * scale, box.width * scale)
    return [(box, float(shapely.hausdorff_distance(polygon, box.shape)))]


def _between(centre: Any, along: np.ndarray, aside: np.ndarray) -> Box:
    """The rectangle between the sides `along` of a parallelogram."""
    side = float(np.hypot(*along))
    ahead = along / side
    width = abs(float(ahead[0] * aside[1] - ahead[1] * aside[0]))
    within = side - abs(float(ahead @ aside))
    length = max(within, min(side, STALL))
    x, y = centre
    return Box(x, y, math.atan2(ahead[1], ahead[0]), length, width)


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

    Each shape costs the side that loses the least area. If more is left so, the shapes
    along each long side cost that side together.

    Args:
        box: to cut.
        others: shapely polygons.
        gap: left between the rectangle and the shapes [m].
    """
    others = list(others)
    found = [_cut_each(box, others, gap)]
    whole = shapely.box(*np.divide([-box.length, -box.width, *box.size], 2))
    hits = [box.local(other).intersection(whole) for other in others]
    rows = np.array([hit.bounds for hit in hits if hit.area > 1e-9]).reshape(-1, 4)
    left = rows[:, 1].min(initial=box.width / 2, where=rows[:, 1] > 0)
    right = rows[:, 3].max(initial=-box.width / 2, where=rows[:, 3] < 0)
    if left - right < box.width - 2 * gap > 0:
        half = box.length / 2
        part = box.part(-half, half, right, left)
        part = dataclasses.replace(part, width=part.width - 2 * gap)
        if part.width > 0:
            found.append(_cut_each(part, others, gap))
    clear = [one for one in found if one]
    return max(clear, key=lambda one: one.length * one.width, default=None)


def _cut_each(box: Box, others: list[Any], gap: float) -> Box | None:
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
