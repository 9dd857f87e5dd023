"""Spots that a map gives by their number, their place or the lines between them."""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import shapely

from carpark_formats.maps.features import (
    Feature,
    Plan,
    first_names,
    on_same_level,
    tagged,
)
from carpark_formats.maps.fit import Box, around, leaning, parallelogram
from carpark_mj.layouts.standards import DesignCar

# Sizes [m] of bays between lines, a wider range than `layouts.standards` has. Twice the
# least is the most, so that a bay is never taken for two.
WIDTHS = (2.0, 4.0)
LENGTHS = (4.0, 8.0)
KERBSIDE_WIDTHS, KERBSIDE_LENGTHS = (1.8, 3.5), (4.5, 8.0)  # of bays along the aisle
PARALLEL = np.radians(4.0)  # between the sides of a bay
UNEVEN = 0.75  # of the sides of a bay, the shorter to the longer
STAGGER = 1.8  # of the sides to the width: bays at 30 deg or more to the aisle
OVERLAP = 0.2  # of a bay, by which it may overlap another
STRAIGHT = 0.05  # m, smaller bends of a line are none
MOST_LINES = 3_000
MOST_PAIRS = 10_000  # of lines with room for a bay between them
# Length and width [m] of bays across and along the road (`layouts.standards`, [rast]).
ACROSS, ALONG = (5.0, 2.5), (6.0, 2.0)
LONG, WIDE = (4.2, 7.5), (1.85, 4.2)  # m, of the pieces of a row
NEAREST_ROAD = 12.0  # m from a road, for a spot drawn as a point
FILLED = 0.8  # share of the rectangle around a row with other than four corners
SURVEYED = 0.1  # of a spot that a row of full spots may lack
WITHIN = 0.97  # share of a bay beside an aisle that must be in the car park
SHARED = 0.3  # m2 that it may share with roads and other bays


def is_bay_sized(polygon: Any) -> bool:
    """Whether a polygon is no larger than one bay."""
    box = around(polygon)
    return box.length <= LENGTHS[1] and box.width <= WIDTHS[1]


def bays_between(lines: Sequence[Any], taken: Sequence[Any] = ()) -> list[Any]:
    """The bays that lines bound.

    Cells that lines enclose are bays as they are. Elsewhere a bay lies between two
    parallel lines beside each other. Lines twice as long as a bay divide two rows of
    them, back to back. Bays (polygons) overlap neither each other nor those of `taken`.
    """
    drawn = _segments(lines)
    if len(drawn) > MOST_LINES:
        raise ValueError(f"{len(drawn)} lines divide bays; at most {MOST_LINES}")
    net = shapely.union_all(drawn)
    cells = filter(is_bay_sized, shapely.get_parts(shapely.polygonize([net])))
    cells = [cell for cell in cells if around(cell).width >= WIDTHS[0]]
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
    """Rectangles between parallel segments, nearest segments first.

    `side` is the range of their length [m], up to twice the most for two bays each, and
    `apart` that of the distance between them [m].
    """
    length = shapely.length(lines)
    lines = lines[(length >= side[0]) & (length <= 2 * side[1])]
    near = shapely.box(*(shapely.bounds(lines) + np.repeat([-apart[1], apart[1]], 2)).T)
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
    order = np.argsort(width + OVERLAP * shift, kind="stable")
    found: list[Any] = []
    for pair in order[kept[order]]:
        a, b = first[pair], second[pair]
        pose = *(middle[a] + middle[b]) / 2, yaw[a] + turn[pair] / 2
        box = Box(*map(float, (*pose, long[pair], width[pair])))
        half, double = box.length / 2, box.length > side[1]
        parts = [box.part(-half, 0.0), box.part(0.0, half)] if double else [box]
        found += [part.shape for part in parts]
    return found


def _apart(shapes: list[Any], taken: Sequence[Any]) -> list[Any]:
    """The shapes that overlap none before them and none of `taken`."""
    every = np.array([*taken, *shapes], object)
    later, earlier = shapely.STRtree(every).query(every, "intersects")
    later, earlier = np.stack([later, earlier])[:, earlier < later]
    common = shapely.area(shapely.intersection(every[later], every[earlier]))
    area = shapely.area(every)
    over = common > OVERLAP * np.minimum(area[later], area[earlier])
    kept = np.full(len(every), True)
    # Rows of pairs are in the order of the later shape.
    for late, early in np.stack([later, earlier], axis=-1)[over]:
        kept[late] &= not (kept[early])
    return [every[k] for k in range(len(taken), len(every)) if kept[k]]


def lay_out(plan: Plan) -> Plan:
    """Turns spots without outlines into bays, see `maps`; notes say what was assumed.

    Spots drawn inside a group stay, and are all of it if it has no number.
    """
    groups, report = tagged(plan.features, "spots"), plan.report
    features = [one for one in plan.features if one.tag != "spots"]
    roads = tagged(features, "lane")
    ways = shapely.union_all([road.shape for road in roads])
    walls = [one.shape for one in tagged(features, "wall", "kerb", "pillar")]
    walls = [wall for wall in walls if not wall.intersects(ways)]
    points = [group for group in groups if not group.shape.area]
    areas = [group for group in groups if group.shape.area]
    drawn = [one.shape.centroid for one in tagged(features, "bay")]
    drawn += [group.shape for group in points]
    laid: list[str] = []
    askew: list[str] = []  # rows without an angle in the map
    # Smaller areas first: a row is often drawn inside its car park.
    for group in sorted(areas, key=lambda group: group.shape.area):
        inside = sum(bool(group.shape.covers(spot)) for spot in drawn)
        alone = group.is_row and group.count == 1
        pieces = [group.shape] if alone else [*divided(group)]
        is_row = group.is_row or bool(pieces)
        if not is_row:
            ground = Feature("drivable", group.shape, group.name, level=group.level)
            features.append(ground)
        if inside and not (group.count or group.is_row):
            continue
        others = [one.shape for one in tagged(features, "bay")]
        if is_row:
            pieces = [piece for piece in pieces if _has_room(piece, others)]
        else:
            near = [road for road in roads if on_same_level(road, group)]
            pieces = beside_aisles(group.shape, near, [*others, *walls])
        most = max(group.count - inside, 0) if group.count else None
        pieces = [*itertools.islice(pieces, most)]
        drawn += [piece.centroid for piece in pieces]
        features += [_bay(group, piece, k) for k, piece in enumerate(pieces)]
        if pieces and not alone:
            laid.append(f"{len(pieces)} of {group.count or '?'} in {group.name}")
            if group.orientation == "diagonal":
                askew.append(group.name)
        elif not (pieces or inside) and (group.count or group.is_row):
            why = "an area without a row or aisles for its spots"
            report.lost[group.name] = f"{why}: {group.count or '?'}"
    for group, shape in zip(points, _across_roads(points, roads), strict=True):
        if group.count > 1:
            report.lost[group.name] = f"a point for several spots: {group.count}"
        elif shape is None:
            far = f"a point, more than {NEAREST_ROAD:g} m from a road"
            report.lost[group.name] = far
        else:
            features.append(_bay(group, shape, 0))
    if laid:
        report.notes.append(f"spots laid out that are not drawn: {first_names(laid)}")
    if askew:
        why = "diagonal spots laid out as their outline leans, for the map has no angle"
        report.notes.append(f"{why}: {first_names(askew)}")
    if points:
        told = f"{len(points)} spots are points: bays across the nearest road"
        report.notes.append(told)
    return Plan(features, report)


def _bay(group: Feature, shape: Any, number: int) -> Feature:
    name = f"{group.name}/{number + 1}" if group.shape.area else group.name
    return Feature("bay", shape, name, group.kind, level=group.level)


def divided(group: Feature) -> Iterator[Any]:
    """The spots of a row, or of two back to back; none if they had odd sizes.

    A row without a count has as many as have room.
    """
    sides = parallelogram(group.shape) or _bent(group.shape)
    if not sides or not (group.count or group.is_row or group.orientation):
        return
    centre, best, found = np.array(group.shape.centroid.coords[0]), math.inf, None
    for (row, depth), rows in itertools.product((sides, sides[::-1]), (1, 2)):
        run, deep = float(np.hypot(*row)), float(np.hypot(*depth)) / rows
        for across in (True, False):
            if group.orientation and (group.orientation != "parallel") != across:
                continue
            length, width = ACROSS if across else ALONG
            pace = width if across else length
            each = math.ceil(group.count / rows) or int(run / pace + SURVEYED)
            if not each:
                continue
            long, wide = (deep, run / each) if across else (run / each, deep)
            odd = abs(math.log(long / length)) + abs(math.log(wide / width))
            usual = LONG[0] <= long <= LONG[1] and WIDE[0] <= wide <= WIDE[1]
            if usual and odd < best:
                best, found = odd, (row, depth, each, rows)
    if not found:
        return
    row, depth, each, rows = found
    cells = itertools.product(range(rows), range(each))
    for line, place in itertools.islice(cells, group.count or None):
        middle = centre + row * ((place + 0.5) / each - 0.5)
        middle = middle + depth * ((line + 0.5) / rows - 0.5)
        yield leaning(middle, row / each, depth / rows)


def _bent(shape: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """The sides of the rectangle around a shape that nearly fills it; else None."""
    box = around(shape)
    if shape.area < FILLED * box.length * box.width:
        return None
    cos, sin = math.cos(box.yaw), math.sin(box.yaw)
    return box.length * np.array([cos, sin]), box.width * np.array([-sin, cos])


def _has_room(spot: Any, others: list[Any]) -> bool:
    return all(spot.intersection(other).area <= SHARED for other in others)


def beside_aisles(area: Any, roads: list[Feature], taken: list[Any]) -> Iterator[Any]:
    """Bays across the roads of a car park, on both sides, where they have room."""
    ground = shapely.union_all(
        [road.shape.buffer(road.width / 2 - 0.01, cap_style="flat") for road in roads]
    )
    taken = list(taken)
    length, width = ACROSS
    for road in sorted(roads, key=lambda road: -road.shape.length):
        for part in shapely.get_parts(road.shape.intersection(area)):
            if part.length < width:
                continue
            first, last = np.asarray(part.coords)[[0, -1]]
            ahead = (last - first) / part.length
            count = int(part.length / width + SURVEYED)
            spare = (part.length - count * width) / 2
            for side, place in itertools.product((1.0, -1.0), range(count)):
                out = side * np.array([-ahead[1], ahead[0]])
                along = first + ahead * (spare + (place + 0.5) * width)
                x, y = along + out * (road.width + length) / 2
                bay = Box(x, y, math.atan2(out[1], out[0]), length, width).shape
                in_area = bay.intersection(area).area > WITHIN * bay.area
                if in_area and _has_room(bay, [ground, *taken]):
                    taken.append(bay)
                    yield bay


def _across_roads(points: list[Feature], roads: list[Feature]) -> list[Any]:
    """Bays around points, each beside the nearest road; None where there is none."""
    spots = [group.shape for group in points]
    tree = shapely.STRtree(spots)
    found: list[Any] = []
    for group, spot in zip(points, spots, strict=True):
        road = min(roads, key=lambda road: road.shape.distance(spot), default=None)
        if road is None or road.shape.distance(spot) > NEAREST_ROAD:
            found.append(None)
            continue
        parallel = group.orientation == "parallel"
        length, width = ALONG if parallel else ACROSS
        # Points are no surveyed middles: neighbours closer than a bay share the room.
        near: dict[str, Any] = {"exclusive": True, "return_distance": True}
        gaps = tree.query_nearest(spot, max_distance=width, **near)[1]
        width = min([width, *gaps[gaps > DesignCar().width]])
        start, end = np.asarray(road.shape.coords)[[0, -1]]
        yaw = math.atan2(*(end - start)[::-1]) + (0.0 if parallel else math.pi / 2)
        found.append(Box(spot.x, spot.y, yaw, length, width).shape)
    return found
