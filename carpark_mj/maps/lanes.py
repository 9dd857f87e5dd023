"""Lanes of a map, joined to the long straight ones that layouts have."""

import math

import numpy as np
import shapely

from carpark_mj.maps.features import Feature
from carpark_mj.maps.fit import Box

ALIGNED = math.radians(6.0)  # between lanes that are one
ASIDE = 0.8  # m between the centre lines of lanes that are one
GAP = 8.0  # m between their ends, for one to cross a junction


def joined_lanes(features: list[Feature]) -> list[tuple[Box, bool]]:
    """Rectangles of lanes, and whether they are driven along their heading only.

    Lanes in line are joined. Two opposite lanes on the same ground become one two-way
    lane.
    """
    rest = sorted(
        ((_box(one), one.one_way) for one in features if one.shape.length > 0.1),
        key=lambda lane: -lane[0].length,
    )
    found = []
    while rest:
        (first, one_way), *rest = rest
        back, front, widths = -first.length / 2, first.length / 2, [first.size]
        grown = True
        while grown:
            grown, others = False, []
            for lane, only in rest:
                ends = _ends(first, lane)
                if (
                    abs(math.sin(lane.yaw - first.yaw)) > math.sin(ALIGNED)
                    or np.abs(ends[:, 1]).max() > ASIDE
                    or ends[:, 0].min() > front + GAP
                    or ends[:, 0].max() < back - GAP
                ):
                    others.append((lane, only))
                    continue
                back = min(back, ends[:, 0].min())
                front = max(front, ends[:, 0].max())
                widths.append(lane.size)
                against = math.cos(lane.yaw - first.yaw) < 0
                one_way = one_way and only and not against
                grown = True
            rest = others
        lengths, wide = np.array(widths).T
        width = float(np.average(wide, weights=lengths))
        whole = Box(first.x, first.y, first.yaw, first.length, width)
        found.append((whole.part(back, front, -width / 2, width / 2), one_way))
    return [(_reaching(lane, found), one_way) for lane, one_way in found]


def _reaching(lane: Box, lanes: list[tuple[Box, bool]]) -> Box:
    """A lane lengthened at either end to the next one ahead, within `GAP`."""
    others = [other.shape for other, _ in lanes if other is not lane]
    ends: list[float] = []
    for side in (-1.0, 1.0):
        start = side * lane.length / 2
        ahead = shapely.LineString([(start, 0.0), (start + side * GAP, 0.0)])
        gaps = [
            hit.distance(shapely.Point(start, 0.0))
            for other in others
            if not (hit := lane.local(other).intersection(ahead)).is_empty
        ]
        ends.append(start + side * min(gaps, default=0.0))
    back, front = ends
    return lane.part(back, front, -lane.width / 2, lane.width / 2)


def _box(feature: Feature) -> Box:
    start, end = np.asarray(feature.shape.coords)[[0, -1]]
    (x, y), (dx, dy) = (start + end) / 2, end - start
    return Box(x, y, math.atan2(dy, dx), math.hypot(dx, dy), feature.width)


def _ends(frame: Box, lane: Box) -> np.ndarray:
    """The ends (2, 2) of a lane's centre line in the frame of another."""
    step = np.array([math.cos(lane.yaw), math.sin(lane.yaw)]) * lane.length / 2
    delta = np.array([lane.x - frame.x, lane.y - frame.y]) + np.array([step, -step])
    cosine, sine = math.cos(frame.yaw), math.sin(frame.yaw)
    return delta @ np.array([[cosine, -sine], [sine, cosine]])
