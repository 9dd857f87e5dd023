"""OpenStreetMap: parking spaces, aisles, barriers and buildings by their tags."""

import itertools
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from carpark_mj.layouts.types import BayKind
from carpark_mj.maps.features import LINE_THICKNESS, Feature, Group, Plan
from carpark_mj.maps.osm_xml import OsmXml, joined

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


def osm_features(osm: OsmXml) -> Plan:
    """The features of a map."""
    plan = Plan(unknown=Counter(osm.faults))
    used: set[str] = set()
    for name, relation in osm.relations.items():
        if relation.tags.get("type") != "multipolygon":
            plan.unknown[f"relation {relation.tags.get('type', 'without a type')}"] += 1
            continue
        outer = [
            (way, osm.ways[way].shape)
            for role, way in relation.members
            if way in osm.ways and role != "inner"
        ]
        # Older maps have the tags on the outer way.
        if any(key in relation.tags for key in ("amenity", "building", "barrier")):
            used.update(way for way, _ in outer)
            add_by_tags(
                plan, name, relation.tags, joined([shape for _, shape in outer])
            )
    for name, way in osm.ways.items():
        if name not in used:
            add_by_tags(plan, name, way.tags, way.shape)
    for name, (place, tags) in osm.nodes.items():
        if tags:
            add_by_tags(plan, name, tags, shapely.Point(place))
    return plan


def add_by_tags(plan: Plan, name: str, tags: Mapping[str, Any], shape: Any) -> None:
    """Adds a shape with the meaning of its tags, or counts it as unknown."""
    if shape is None or shape.is_empty:
        if tags.get("amenity") == "parking_space":
            plan.lost[name] = "its lines close no polygon"
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
        plan.unknown[f"{left[0]}={tags[left[0]]}"] += 1


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
    elif shape.length or not is_spot:
        if is_spot:
            plan.lost[name] = f"a {shape.geom_type.lower()}, not an area"
        elif count:
            plan.lost[name] = f"a point for several spots: {count}"
        return
    if is_spot and shape.area and count <= 1:
        plan.features.append(Feature("bay", shape, name, kind, level=level))
        return
    if tags.get("parking") in _COVERED and not level:
        plan.features.append(Feature("drivable", shape, name))
        if count:
            where = f"{tags['parking']}, its {count} spots are not laid out"
            plan.notes.append(f"{name}: {where}")
        return
    is_row = is_spot or tags.get("parking") in _ROWS
    plan.groups.append(Group(name, shape, count, str(orientation), is_row, kind, level))


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
    points = shapely.get_coordinates(line.simplify(0.5))
    return [
        Feature(
            "lane",
            shapely.LineString(part),
            name,
            width=width,
            one_way=one_way,
            level=level,
        )
        for part in itertools.pairwise(points)
        if np.ptp(part, axis=0).max() > 0
    ]
