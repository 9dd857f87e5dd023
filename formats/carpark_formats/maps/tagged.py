"""Shapes by their tags, ours or OpenStreetMap's; GeoJSON, which has both.

The property `tag` is one of `features.Tag`; `width` [m] and `one_way` belong to lanes.
Coordinates of GeoJSON are longitude and latitude, or of the system that the member
`crs` or the flag `--crs` names.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import shapely
from shapely.errors import ShapelyError

from carpark_formats.maps.features import (
    LINE_THICKNESS,
    WGS84,
    Feature,
    Plan,
    Tag,
    lane_features,
    to_metres,
)
from carpark_formats.maps.fit import boxes, opened
from carpark_mj.layouts.types import BayKind
from carpark_mj.reading import parse_object, read_text

# Widths [m] of aisles that have none in the map, driven both ways and one way: the
# least that standards ask for (`layouts.standards`), before bays and walls cut them.
AISLE, ONE_WAY_AISLE = 6.0, 3.5
BOLLARD_RADIUS = 0.15  # m
_BARRIERS = {"kerb": "kerb", "bollard": "pillar", "block": "pillar"}
_OPEN = ("gate", "lift_gate", "swing_gate", "entrance", "cattle_grid", "toll_booth")
_KINDS = {
    "disabled": BayKind.ACCESSIBLE,
    "parent": BayKind.FAMILY,
    "reserved": BayKind.RESERVED,
}
_ROADS = ("service", "residential", "unclassified", "living_street", "track")
# Values of `parking`: beside a road without an aisle, and on several floors.
_ROWS = ("street_side", "lane", "on_kerb", "half_on_kerb", "shoulder")
_COVERED = ("underground", "multi-storey", "rooftop", "sheds", "garage_boxes")
_PLAIN = {"source", "name", "note", "created_by", "ref", "layer", "level", "type"}
_WGS84 = {"properties": {"name": WGS84}}
NARROW = 2.0  # m, less of an aisle is no lane
DETAIL = 0.25  # m, smaller bends of an aisle are straightened


def add_by_tags(plan: Plan, name: str, tags: Mapping[str, Any], shape: Any) -> None:
    """Adds a shape with the meaning of its tags, or counts it as unknown."""
    if shape is None or shape.is_empty:
        if tags.get("amenity") == "parking_space":
            plan.report.lost[name] = _no_area(None)
        return
    is_area = bool(shape.area)
    level = str(tags.get("level") or tags.get("layer") or "")
    if tags.get("amenity") in ("parking_space", "parking"):
        _add_parking(plan, name, tags, shape, level)
    elif tags.get("highway") in _ROADS and not is_area:
        plan.features.extend(_lanes(name, tags, shape, level))
    elif barrier := tags.get("barrier"):
        if barrier not in _OPEN:
            tag = _BARRIERS.get(str(barrier), "wall")
            # A closed line surrounds its ground unless it is said to be an area.
            if is_area and tag != "pillar" and tags.get("area") != "yes":
                shape, is_area = shape.boundary, False
            radius = LINE_THICKNESS / 2 if shape.length else BOLLARD_RADIUS
            solid = shapely.make_valid(shape) if is_area else shape.buffer(radius)
            plan.features.append(Feature(tag, solid, name, level=level))  # pyright: ignore
    elif tags.get("building", "no") != "no" and is_area:
        shape = shapely.make_valid(shape)
        if tags["building"] in ("parking", "carport"):
            # The ground floor of a multi-storey car park is no wall.
            plan.features.append(Feature("drivable", shape, name))
        elif tags["building"] != "roof":  # cars drive and park below
            plan.features.append(Feature("wall", shape, name))
    elif left := sorted(set(tags) - _PLAIN):
        plan.report.unknown[f"{left[0]}={tags[left[0]]}"] += 1


def _add_parking(
    plan: Plan, name: str, tags: Mapping[str, Any], shape: Any, level: str
) -> None:
    """Adds a spot, or a group of spots that have no outlines of their own."""
    is_spot = tags["amenity"] == "parking_space"
    kind = _KINDS.get(str(tags.get("parking_space", "")), BayKind.STANDARD)
    if tags.get("wheelchair") == "designated" or (
        is_spot and tags.get("capacity:disabled", "no") not in ("no", "0")
    ):
        kind = BayKind.ACCESSIBLE
    try:
        count = max(int(str(tags.get("capacity", ""))), 0)
    except ValueError:
        count = 0
    orientation = tags.get("orientation") or tags.get("parking:orientation") or ""
    if shape.area:
        shape = shapely.make_valid(shape)
    elif is_spot and shape.length:
        plan.report.lost[name] = _no_area(shape)
        return
    elif not is_spot:
        if count:
            plan.report.lost[name] = f"a point for several spots: {count}"
        return
    if is_spot and shape.area and count <= 1:
        plan.features.append(Feature("bay", shape, name, kind, level=level))
        return
    if tags.get("parking") in _COVERED and not level:
        plan.features.append(Feature("drivable", shape, name))
        if count:
            where = f"{tags['parking']}, its {count} spots are not laid out"
            plan.report.notes.append(f"{name}: {where}")
        return
    is_row = is_spot or tags.get("parking") in _ROWS
    plan.features.append(
        Feature("spots", shape, name, kind, level, count, str(orientation), is_row)
    )


def _lanes(name: str, tags: Mapping[str, Any], line: Any, level: str) -> list[Feature]:
    """The straight parts of a road."""
    oneway = str(tags.get("oneway", "no"))
    one_way = oneway in ("yes", "true", "1", "-1", "reverse", "True")
    if oneway in ("-1", "reverse"):
        line = line.reverse()
    try:
        width = float(str(tags.get("width") or tags["est_width"]).removesuffix(" m"))
    except (KeyError, ValueError):
        width = 0.0
    if not 2.0 <= width <= 30.0:
        width = ONE_WAY_AISLE if one_way else AISLE
    return lane_features(name, line, width, one_way, level)


def add_tagged(
    plan: Plan, name: str, shape: Any, tags: Mapping[str, Any], word: str = ""
) -> None:
    """Adds a shape by its `tag`, or by the tags of OpenStreetMap if it has none.

    `word` is the map's own for the tag, which the report uses.
    """
    tag = tags.get("tag")
    if tag is None:
        add_by_tags(plan, name, tags, shape)
    elif tag not in get_args(Tag):
        plan.report.unknown[f"tag={tag}"] += 1
    elif tag == "lane" and shape.area:
        _add_aisle(plan, name, shapely.make_valid(shape), bool(tags.get("one_way")))
    elif tag == "lane":
        road = {key: tags.get(key) for key in ("width", "level")}
        road |= {"highway": "service", "oneway": "yes" if tags.get("one_way") else "no"}
        add_by_tags(plan, name, road, shape)
    else:
        if shape and not shape.area and tag in ("wall", "kerb", "pillar"):
            shape = shape.buffer(LINE_THICKNESS / 2)
        if shape and shape.area:
            shape, level = shapely.make_valid(shape), str(tags.get("level") or "")
            plan.features.append(Feature(tag, shape, name, level=level))
        elif tag == "bay":
            plan.report.lost[name] = _no_area(shape)
        else:
            plan.report.unknown[f"{word or tag} that is no area"] += 1


def _no_area(shape: Any) -> str:
    """Why a spot has no area; its shape is None if it consists of lines."""
    if shape is None:
        return "its lines close no polygon"
    return f"a {shape.geom_type.lower()}, not an area"


def _add_aisle(plan: Plan, name: str, ground: Any, one_way: bool) -> None:
    """Adds the ground of an aisle, and lanes along the rectangles that cover it."""
    plan.features.append(Feature("drivable", ground, name))
    # Without its narrow corners and small bends.
    for box in boxes(opened(ground, NARROW).simplify(DETAIL)):
        dx, dy = (box.length / 2 * f(box.yaw) for f in (math.cos, math.sin))
        line = shapely.LineString([(box.x - dx, box.y - dy), (box.x + dx, box.y + dy)])
        plan.features.extend(lane_features(name, line, box.width, one_way))


def geojson_features(path: Path, crs: str | None = None) -> Plan:
    """Reads a collection, a feature, or a bare geometry; `crs` replaces the file's."""
    data = parse_object(read_text(path), "the GeoJSON")
    rows = data.get("features")
    if not isinstance(rows, list):
        rows = [data if data.get("type") == "Feature" else {"geometry": data}]
    plan, shapes, names, properties = Plan(), [], [], []
    for index, row in enumerate(rows):
        try:
            tags = dict(row.get("properties") or {})
            geometry = row.get("geometry")  # RFC 7946, section 3.2: None has no place
            shape = geometry is not None and shapely.from_geojson(json.dumps(geometry))
        except (ShapelyError, AttributeError, ValueError, TypeError):
            raise ValueError(
                f"features[{index}] must have a geometry, and an object as properties, "
                f"not {str(row)[:60]}"
            ) from None
        if not shape:
            plan.report.unknown["feature without a geometry"] += 1
            continue
        for part in shapely.get_parts(shape):
            shapes.append(shapely.force_2d(part))
            names.append(str(row.get("id", index)))
            properties.append(tags)
    if not shapes:
        raise ValueError("the GeoJSON has no feature with a geometry")
    try:
        system = crs or str((data.get("crs") or _WGS84)["properties"]["name"])
    except (TypeError, KeyError):
        raise ValueError(
            f"crs must have properties with a name, not {data['crs']}"
        ) from None
    xy = to_metres(shapely.get_coordinates(shapes), system)
    placed = shapely.set_coordinates(np.array(shapes), xy)
    for name, shape, tags in zip(names, placed, properties, strict=True):
        add_tagged(plan, name, shape, tags)
    return plan
