"""Spots that a map gives by their number or place, laid out as bays of usual size."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely

from carpark_mj.layouts.standards import DesignCar
from carpark_mj.maps.features import Feature, Group, Plan, on_same_level
from carpark_mj.maps.fit import Box, around, leaning, parallelogram

# Length and width [m] of bays across and along the road (`layouts.standards`, [rast]).
ACROSS, ALONG = (5.0, 2.5), (6.0, 2.0)
LONG, WIDE = (4.2, 7.5), (1.85, 4.2)  # m, of the pieces of a row
NEAREST_ROAD = 12.0  # m from a road, for a spot drawn as a point
NAMED = 5  # groups that a note names
FILLED = 0.8  # share of the rectangle around a row with other than four corners
SURVEYED = 0.1  # of a spot that a row of full spots may lack
WITHIN = 0.97  # share of a bay beside an aisle that must be in the car park
SHARED = 0.3  # m2 that it may share with roads and other bays


def lay_out(plan: Plan) -> Plan:
    """Turns groups of spots into spots with outlines; notes say what was assumed.

    A point becomes a bay across the nearest road, a row is divided into its number of
    spots, and in the rest of a car park bays stand on both sides of its aisles. Spots
    drawn inside a group stay, and are all of it if it has no number.
    """
    features, lost, notes = list(plan.features), dict(plan.lost), list(plan.notes)
    roads = [one for one in plan.features if one.tag == "lane"]
    ways = shapely.union_all([road.shape for road in roads])
    walls = [
        one.shape
        for one in plan.features
        if one.tag in ("wall", "kerb", "pillar") and not one.shape.intersects(ways)
    ]
    points = [group for group in plan.groups if not group.shape.area]
    areas = [group for group in plan.groups if group.shape.area]
    drawn = [one.shape.centroid for one in features if one.tag == "bay"]
    drawn += [group.shape for group in points]
    laid: list[str] = []
    # Smaller areas first: a row is often drawn inside its car park.
    for group in sorted(areas, key=lambda group: group.shape.area):
        inside = sum(bool(group.shape.covers(spot)) for spot in drawn)
        alone = group.is_row and group.count == 1
        pieces = [group.shape] if alone else [*divided(group)]
        is_row = group.is_row or bool(pieces)
        features += [] if is_row else [_ground(group)]
        if inside and not (group.count or group.is_row):
            continue
        others = [one.shape for one in features if one.tag == "bay"]
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
            told = f"{len(pieces)} of {group.count or '?'} in {group.name}"
            laid.append(told)
        elif not (pieces or inside) and (group.count or group.is_row):
            count = group.count or "?"
            lost[group.name] = f"an area without a row or aisles for its spots: {count}"
    beside = _across_roads(points, roads)
    for group, shape in zip(points, beside, strict=True):
        if shape is None or group.count > 1:
            lost[group.name] = (
                f"a point for several spots: {group.count}"
                if group.count > 1
                else f"a point, more than {NEAREST_ROAD:g} m from a road"
            )
        else:
            features.append(_bay(group, shape, 0))
    if laid:
        told = ", ".join(laid[:NAMED]) + ", ..." * (len(laid) > NAMED)
        notes.append(f"spots laid out that are not drawn: {told}")
    if points:
        notes.append(f"{len(points)} spots are points: bays across the nearest road")
    return dataclasses.replace(
        plan, features=features, lost=lost, groups=[], notes=notes
    )


def _ground(group: Group) -> Feature:
    return Feature("drivable", group.shape, group.name, level=group.level)


def _bay(group: Group, shape: Any, number: int) -> Feature:
    name = f"{group.name}/{number + 1}" if group.shape.area else group.name
    return Feature("bay", shape, name, group.kind, level=group.level)


def divided(group: Group) -> Iterator[Any]:
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
    ahead = np.array([math.cos(box.yaw), math.sin(box.yaw)])
    return box.length * ahead, box.width * np.array([-ahead[1], ahead[0]])


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


def _across_roads(points: list[Group], roads: list[Feature]) -> list[Any]:
    """Bays around points, each beside the nearest road; None where there is none."""
    spots = [group.shape for group in points]
    tree = shapely.STRtree(spots)
    found: list[Any] = []
    for group, spot in zip(points, spots, strict=True):
        road = min(roads, key=lambda road: road.shape.distance(spot), default=None)
        if road is None or road.shape.distance(spot) > NEAREST_ROAD:
            found.append(None)
            continue
        length, width = ALONG if group.orientation == "parallel" else ACROSS
        gaps = tree.query_nearest(
            spot, exclusive=True, return_distance=True, max_distance=width
        )[1]
        # Points are no surveyed middles: neighbours closer than a bay share the room.
        width = min([width, *(gap for gap in gaps if gap > DesignCar().width)])
        start, end = np.asarray(road.shape.coords)[[0, -1]]
        yaw = math.atan2(*(end - start)[::-1])
        yaw += 0.0 if group.orientation == "parallel" else math.pi / 2
        found.append(Box(spot.x, spot.y, yaw, length, width).shape)
    return found
