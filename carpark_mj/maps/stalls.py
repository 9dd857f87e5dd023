"""Bays from the lines that divide them, as plans draw them and as they are painted."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from carpark_mj.maps.fit import Box, around

# Sizes [m] of bays between lines, a wider range than `layouts.standards` has. Twice the
# least is the most, so that a bay is never taken for two.
WIDTHS = (2.0, 4.0)
LENGTHS = (4.0, 8.0)
KERBSIDE_WIDTHS, KERBSIDE_LENGTHS = (1.8, 3.5), (4.5, 8.0)  # of bays along the aisle
PARALLEL = np.radians(4.0)  # between the sides of a bay
UNEVEN = 0.75  # of the sides of a bay, the shorter to the longer
STAGGER = 1.8  # of the sides to the width: bays at 30 deg or more to the aisle
SHARED = 0.2  # of a bay, by which it may overlap another
STRAIGHT = 0.05  # m, smaller bends of a line are none
MOST_LINES = 3_000
MOST_PAIRS = 10_000  # of lines with room for a bay between them


def is_bay_sized(polygon: Any) -> bool:
    """Whether a polygon is no larger than one bay."""
    box = around(polygon)
    return box.length <= LENGTHS[1] and box.width <= WIDTHS[1]


def bays_between(lines: Sequence[Any], taken: Sequence[Any] = ()) -> list[Any]:
    """The bays that lines bound.

    Cells that lines enclose are bays as they are. Elsewhere a bay lies between two
    parallel lines beside each other. Lines twice as long as a bay divide two rows of
    them, back to back.

    Args:
        lines: shapely lines [m].
        taken: polygons of bays known otherwise.

    Returns:
        Polygons that overlap neither each other nor `taken`.

    Raises:
        ValueError: too many lines.
    """
    drawn = _segments(lines)
    if len(drawn) > MOST_LINES:
        raise ValueError(f"{len(drawn)} lines divide bays; at most {MOST_LINES}")
    net = shapely.union_all(drawn)
    cells = [
        cell
        for cell in shapely.get_parts(shapely.polygonize([net]))
        if is_bay_sized(cell) and around(cell).width >= WIDTHS[0]
    ]
    # Lines may end where others cross them, as the middle line of two rows.
    found = _between(np.concatenate([drawn, _segments([net])]), LENGTHS, WIDTHS)
    # The ends of closed bays on either side of an aisle are no bays along it.
    edges = shapely.union_all([cell.exterior for cell in cells]).buffer(STRAIGHT)
    loose = drawn[~shapely.covered_by(drawn, edges)]
    found += _between(loose, KERBSIDE_WIDTHS, KERBSIDE_LENGTHS)
    return _apart([*cells, *found], taken)


def _segments(lines: Sequence[Any]) -> np.ndarray:
    """The straight parts of lines."""
    pairs = [np.zeros((0, 2, 2))]
    for line in shapely.get_parts(shapely.simplify(np.array(lines, object), STRAIGHT)):
        points = shapely.get_coordinates(line)
        pairs.append(np.stack([points[:-1], points[1:]], axis=1))
    segments: Any = shapely.linestrings(np.concatenate(pairs))
    return segments


def _between(
    lines: np.ndarray, side: tuple[float, float], apart: tuple[float, float]
) -> list[Any]:
    """Rectangles between parallel segments, those of the nearest ones first.

    Args:
        lines: shapely segments.
        side: range of their length [m]; up to twice the most, of two bays each.
        apart: range of the distance between them [m].
    """
    length = shapely.length(lines)
    lines = lines[(length >= side[0]) & (length <= 2 * side[1])]
    low_x, low_y, high_x, high_y = shapely.bounds(lines).T
    far = apart[1]
    near = shapely.box(low_x - far, low_y - far, high_x + far, high_y + far)
    first, second = shapely.STRtree(lines).query(near)
    first, second = np.stack([first, second])[:, first < second]
    ends = shapely.get_coordinates(lines).reshape(-1, 2, 2)
    step, middle = ends[:, 1] - ends[:, 0], ends.mean(axis=1)
    length, yaw = np.hypot(*step.T), np.arctan2(step[:, 1], step[:, 0])
    turn = (yaw[second] - yaw[first] + np.pi / 2) % np.pi - np.pi / 2
    along = np.stack([np.cos(yaw[first] + turn / 2), np.sin(yaw[first] + turn / 2)])
    delta = (middle[second] - middle[first]).T
    width = np.abs(along[0] * delta[1] - along[1] * delta[0])
    shift = np.abs((along * delta).sum(axis=0))
    long = np.minimum(length[first], length[second])
    kept = (
        (np.abs(turn) < PARALLEL)
        & (long > UNEVEN * np.maximum(length[first], length[second]))
        & (apart[0] <= width)
        & (width <= apart[1])
        & (shift <= np.minimum(STAGGER * width, long / 2 + side[0] / 2))
    )
    if kept.sum() > MOST_PAIRS:
        raise ValueError(f"more than {MOST_PAIRS} pairs of lines may bound bays")
    order = np.argsort(width + SHARED * shift, kind="stable")
    found: list[Any] = []
    for pair in order[kept[order]]:
        a, b = first[pair], second[pair]
        x, y = (float(value) for value in (middle[a] + middle[b]) / 2)
        box = Box(
            x, y, float(yaw[a] + turn[pair] / 2), float(long[pair]), float(width[pair])
        )
        half, wide = box.length / 2, box.width / 2
        if box.length <= side[1]:
            found.append(box.shape)
        else:
            found.append(box.part(-half, 0.0, -wide, wide).shape)
            found.append(box.part(0.0, half, -wide, wide).shape)
    return found


def _apart(shapes: list[Any], taken: Sequence[Any]) -> list[Any]:
    """The shapes that overlap none before them and none of `taken`."""
    every = np.array([*taken, *shapes], object)
    later, earlier = shapely.STRtree(every).query(every, "intersects")
    later, earlier = np.stack([later, earlier])[:, earlier < later]
    common = shapely.area(shapely.intersection(every[later], every[earlier]))
    over = common > SHARED * np.minimum(
        shapely.area(every[later]), shapely.area(every[earlier])
    )
    kept = np.full(len(every), True)
    # Rows of pairs are in the order of the later shape.
    for late, early in np.stack([later, earlier], axis=-1)[over]:
        kept[late] &= not (kept[early])
    return [every[k] for k in range(len(taken), len(every)) if kept[k]]
