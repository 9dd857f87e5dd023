"""Rectangles that fit polygons, are cut until they are free, and join to lanes."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import shapely
from shapely import affinity, ops

from carpark_formats.maps.features import Feature

STALL = 5.0  # m, length that a leaning spot shorter than its sides may have
CORNER = 0.15  # m by which a corner of a spot stands out
LEAN = 0.3  # cosine between sides (73 deg) below which a spot may be a rhombus ...
ALIKE = 0.75  # ... if its sides have at least this ratio
SLACK = 0.5  # m by which the rectangle of a wall may be thicker than the wall
EPSILON = 1e-4  # m by which a cut reaches beyond the polygon
DEEPEST = 16  # cuts of one polygon within each other
MOST_CORNERS = 150  # of a polygon that is cut at its corners, each of which is tried
REFLEX = math.radians(5.0)  # beyond 180 deg, of a corner worth a cut
ALIGNED = math.radians(6.0)  # between lanes that are one
ASIDE = 0.8  # m between the centre lines of lanes that are one
GAP = 8.0  # m between their ends, for one to cross a junction


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
        x, y = self.length / 2, self.width / 2
        box = affinity.rotate(shapely.box(-x, -y, x, y), self.yaw, (0, 0), True)
        return affinity.translate(box, self.x, self.y)

    def turned(self) -> "Box":
        """The rectangle, heading the other way."""
        yaw = math.remainder(self.yaw + math.pi, math.tau)
        return dataclasses.replace(self, yaw=yaw)

    def local(self, shape: Any) -> Any:
        """A shape in the rectangle's own frame."""
        moved = affinity.translate(shape, -self.x, -self.y)
        return affinity.rotate(moved, -self.yaw, (0, 0), use_radians=True)

    def part(
        self,
        back: float,
        front: float,
        right: float | None = None,
        left: float | None = None,
    ) -> "Box":
        """The part within these coordinates of its own frame, as wide by default."""
        right = -self.width / 2 if right is None else right
        left = self.width / 2 if left is None else left
        along, aside = (back + front) / 2, (right + left) / 2
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        x = self.x + along * cosine - aside * sine
        y = self.y + along * sine + aside * cosine
        return Box(x, y, self.yaw, front - back, left - right)


def around(polygon: Any) -> Box:
    """The smallest rectangle around a polygon, its length the longer side."""
    hull = shapely.minimum_rotated_rectangle(polygon)
    sides = np.diff(np.asarray(hull.exterior.coords)[:3], axis=0)
    if np.hypot(*sides[1]) > np.hypot(*sides[0]):
        sides = sides[::-1]
    (x, y), length = hull.centroid.coords[0], np.hypot(*sides[0])
    yaw = math.atan2(sides[0, 1], sides[0, 0])
    return Box(x, y, yaw, float(length), float(np.hypot(*sides[1])))


def opened(shape: Any, width: float) -> Any:
    """A shape without its parts that are narrower; gaps are closed if negative."""
    narrow = shape.buffer(-width / 2, join_style="mitre")
    return narrow.buffer(width / 2, join_style="mitre")


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
    one, two, three, four = corners
    sides = (two - one + three - four) / 2, (three - two + four - one) / 2
    long, short = sorted(sides, key=lambda side: -float(np.hypot(*side)))
    return long, short


def leaning(centre: Any, along: np.ndarray, aside: np.ndarray) -> Any:
    """The parallelogram with a centre (2,) and two sides (2,) [m]."""
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = [np.asarray(centre) + (a * along + b * aside) / 2 for a, b in signs]
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
    length = max(side - abs(float(ahead @ aside)), min(side, STALL))
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
            yaw = math.atan2(dy, dx)
            inside = shapely.get_parts(_line(x, y, yaw, reach).intersection(polygon))
            inside = inside[shapely.length(inside) > EPSILON]
            if len(inside):
                nearest = np.argmin(shapely.distance(inside, shapely.Point(x, y)))
                found.append((inside[nearest].length, x, y, yaw))
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
    along each long side cost that side together. A gap [m] is left before each.
    """
    others = list(others)
    found = [_cut_each(box, others, gap)]
    whole = shapely.box(*np.divide([-box.length, -box.width, *box.size], 2))
    hits = [box.local(other).intersection(whole) for other in others]
    rows = np.array([hit.bounds for hit in hits if hit.area > 1e-9]).reshape(-1, 4)
    left = rows[:, 1].min(initial=box.width / 2, where=rows[:, 1] > 0)
    right = rows[:, 3].max(initial=-box.width / 2, where=rows[:, 3] < 0)
    if left - right < box.width - 2 * gap > 0:
        part = box.part(-box.length / 2, box.length / 2, right, left)
        part = dataclasses.replace(part, width=part.width - 2 * gap)
        if part.width > 0:
            found.append(_cut_each(part, others, gap))
    clear = [one for one in found if one]
    return max(clear, key=lambda one: one.length * one.width, default=None)


def _cut_each(box: Box, others: list[Any], gap: float) -> Box | None:
    back, front = -box.length / 2, box.length / 2
    right, left = -box.width / 2, box.width / 2
    for other in others:
        hit = box.local(other).intersection(shapely.box(back, right, front, left))
        if hit.area < 1e-9:
            continue
        low_x, low_y, high_x, high_y = hit.bounds
        length, width = front - back, left - right
        # What is lost of the front, the back, the left or the right, and what is kept.
        cuts = (
            ((front - low_x) * width, (back, low_x - gap, right, left)),
            ((high_x - back) * width, (high_x + gap, front, right, left)),
            ((left - low_y) * length, (back, front, right, low_y - gap)),
            ((high_y - right) * length, (back, front, high_y + gap, left)),
        )
        back, front, right, left = min(cuts, key=lambda cut: cut[0])[1]
        if front <= back or left <= right:
            return None
    return box.part(back, front, right, left)


def joined_lanes(features: list[Feature]) -> list[tuple[Box, bool]]:
    """Rectangles of lanes, and whether they are driven along their heading only.

    Lanes in line are joined. Two opposite lanes on one ground become one two-way
    lane.
    """
    features = [one for one in features if one.shape.length > 0.1]
    if not features:
        return []
    ends = np.array([np.asarray(one.shape.coords)[[0, -1]] for one in features])
    step = ends[:, 1] - ends[:, 0]
    length, yaw = np.hypot(*step.T), np.arctan2(step[:, 1], step[:, 0])
    middle = ends.mean(axis=1)
    width = np.array([one.width for one in features])
    only = np.array([one.one_way for one in features])
    free = np.full(len(features), True)
    lanes, one_way = [], []
    for first in np.argsort(-length, kind="stable"):
        if not free[first]:
            continue
        cosine, sine = math.cos(yaw[first]), math.sin(yaw[first])
        local = (ends - middle[first]) @ np.array([[cosine, -sine], [sine, cosine]])
        in_line = (np.abs(np.sin(yaw - yaw[first])) <= math.sin(ALIGNED)) & (
            np.abs(local[..., 1]).max(axis=1) <= ASIDE
        )
        low, high = local[..., 0].min(axis=1), local[..., 0].max(axis=1)
        back, front = -length[first] / 2, length[first] / 2
        joined = np.arange(len(features)) == first
        while True:
            within = (low <= front + GAP) & (high >= back - GAP)
            more = free & in_line & within & ~joined
            if not more.any():
                break
            joined |= more
            back, front = low[joined].min(), high[joined].max()
        free &= ~joined
        mean = np.average(width[joined], weights=length[joined])
        whole = [*middle[first], yaw[first], length[first], mean]
        lanes.append(Box(*map(float, whole)).part(float(back), float(front)))
        with_it = np.cos(yaw[joined] - yaw[first]) >= 0
        one_way.append(bool((only[joined] & with_it).all()))
    return list(zip(_reaching(lanes), one_way, strict=True))


def _reaching(lanes: list[Box]) -> list[Box]:
    """Lanes lengthened at either end to the next one ahead, within `GAP`."""
    x, y, yaw, length, _ = np.array([dataclasses.astuple(lane) for lane in lanes]).T
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    # Ends of all lanes in their headings, and then their other ends.
    out = np.concatenate([ahead, -ahead])
    ends = np.tile(np.stack([x, y], axis=-1), (2, 1))
    ends = ends + out * np.tile(length / 2, 2)[:, None]
    rays: Any = shapely.linestrings(np.stack([ends, ends + GAP * out], axis=1))
    shapes = np.array([lane.shape for lane in lanes])
    ray, other = shapely.STRtree(shapes).query(rays, "intersects")
    ray, other = np.stack([ray, other])[:, ray % len(lanes) != other]
    hits = shapely.intersection(rays[ray], shapes[other])
    gaps = np.full(len(rays), np.inf)
    np.minimum.at(gaps, ray, shapely.distance(hits, shapely.points(ends[ray])))
    front, back = np.where(np.isfinite(gaps), gaps, 0.0).reshape(2, -1)
    return [
        lane.part(-lane.length / 2 - before, lane.length / 2 + after)
        for lane, before, after in zip(lanes, back, front, strict=True)
    ]
