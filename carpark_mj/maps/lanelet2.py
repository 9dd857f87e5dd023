"""Lanelet2 maps in OSM XML: lanelets, parking spots, walls, kerbs and columns."""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from carpark_mj.maps.features import LINE_THICKNESS, Feature, Plan, Tag
from carpark_mj.maps.osm_xml import OsmXml, Tags, Way, joined

# Subtypes and types in lower case; first what the Lanelet2 documents name, then what
# maps for valet parking have.
_SOLID: dict[str, Tag] = {
    "wall": "wall",
    "fence": "wall",
    "guard_rail": "wall",
    "building": "wall",
    "curbstone": "kerb",
    "walls": "wall",
    "windows": "wall",
    "doors": "wall",
    "kerbs": "kerb",
    "columns": "pillar",
}
_TAGS: dict[str, Tag] = {
    **_SOLID,
    "parking_space": "bay",
    "parking_spot": "bay",
    "parking": "drivable",
    "parking_lot": "drivable",
    "parking_access": "drivable",
    "junction": "drivable",
}
# Subtypes of lanelets that are not driven along.
_ON_FOOT = (
    "crosswalk",
    "walkway",
    "shared_walkway",
    "stairs",
    "pedestrian_lane",
    "bicycle_lane",
)
TURN = np.radians(30.0)  # a lanelet that bends more ...
SHORT = 15.0  # ... over fewer metres joins lanes that cross, and is none itself
BEND = 0.5  # m between a curved lane and its straight parts
_SAMPLES = 9  # along a border


def is_lanelet2(osm: OsmXml) -> bool:
    """Whether a file is a Lanelet2 map rather than one of OpenStreetMap."""
    return any(
        element.tags.get("type") == "lanelet" or _tag(element.tags) == "bay"
        for element in (*osm.relations.values(), *osm.ways.values())
        if "amenity" not in element.tags
    )


def _tag(tags: Tags) -> Tag | None:
    """Tag of an element by its subtype, or else by its type."""
    for key in ("subtype", "type"):
        if found := _TAGS.get(tags.get(key, "").lower()):
            return found
    return None


def lanelet2_features(osm: OsmXml) -> Plan:
    """The features of a map."""
    plan = Plan(unknown=Counter(osm.faults))
    used: set[str] = set()
    for name, relation in osm.relations.items():
        ways = [
            (role, osm.ways[way]) for role, way in relation.members if way in osm.ways
        ]
        if relation.tags.get("type") == "lanelet":
            if (kind := relation.tags.get("subtype", "road")) in _ON_FOOT:
                plan.unknown[f"lanelet {kind}"] += 1
                continue
            one_way = relation.tags.get("one_way", "yes") != "no"
            borders = {role: way.points for role, way in ways}
            level = relation.tags.get("level", "")
            lanelet = [
                dataclasses.replace(one, level=level)
                for one in lanelet_features(name, borders, one_way)
            ]
            plan.features.extend(lanelet)
            if not lanelet:
                plan.unknown["lanelet without two borders"] += 1
        elif _tag(relation.tags) in ("bay", "drivable"):
            used.update(way for _, way in relation.members)
            shape = joined([way.shape for role, way in ways if role != "inner"])
            _add(plan, name, relation.tags, shape)
        else:
            kind = relation.tags.get("subtype") or relation.tags.get("type", "")
            plan.unknown[f"relation {kind or 'without a type'}"] += 1
    for name, way in osm.ways.items():
        if name in used or not (way.tags.get("type") or way.tags.get("subtype")):
            continue  # a piece of a spot or a border of a lanelet
        _add(plan, name, way.tags, _shape(way))
    return plan


def _add(plan: Plan, name: str, tags: Tags, shape: Any) -> None:
    tag = _tag(tags)
    kind = tags.get("subtype") or tags.get("type", "")
    if tag is None:
        plan.unknown[kind] += 1
    elif shape is None or not shape.area:
        if tag == "bay":
            plan.lost[name] = "its lines close no polygon"
        plan.unknown[f"{kind} that closes no polygon"] += 1
    else:
        level = tags.get("level", "")
        plan.features.append(Feature(tag, shapely.make_valid(shape), name, level=level))


def _shape(way: Way) -> Any:
    """The polygon of a way; a line has its own width, or that of a wall."""
    tag, shape = _tag(way.tags), way.shape
    if way.closed:
        if tag not in ("wall", "kerb") or way.tags.get("type", "area") == "area":
            return shape
        shape = shape.exterior  # a closed line surrounds its ground
    try:
        width = float(way.tags["width"])
    except (KeyError, ValueError):
        if tag not in ("wall", "kerb"):
            return None
        width = LINE_THICKNESS
    width = width if 0 < width < 100 else LINE_THICKNESS
    return shape.buffer(width / 2, cap_style="flat", join_style="mitre")


def lanelet_features(
    name: str, borders: Mapping[str, np.ndarray], one_way: bool
) -> list[Feature]:
    """The straight lanes of a lanelet, and the ground that it covers.

    Args:
        name: of the lanelet.
        borders: points (n, 2) of `left` and `right` [m], two at least.
        one_way: whether it is driven in its direction only.

    Returns:
        None at all if a border is missing or they cover no ground.
    """
    if not {"left", "right"} <= set(borders):
        return []
    left, right = (borders[side] for side in ("left", "right"))
    ends = [shapely.LineString([left[i], right[i]]) for i in (0, -1)]
    if ends[0].intersects(ends[1]):
        right = right[::-1]
    ground = shapely.LinearRing(np.concatenate([left, right[::-1]]))
    if ground.is_ccw:  # drawn against the direction of travel
        left, right = left[::-1], right[::-1]
    ground = shapely.make_valid(shapely.Polygon(ground))
    if not ground.area:
        return []
    features = [Feature("drivable", ground, name)]
    line = (_sampled(left) + _sampled(right)) / 2
    steps = np.diff(line, axis=0)
    turned = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    length = float(np.hypot(*steps.T).sum())
    if np.ptp(turned) > TURN and length < SHORT:
        return features
    width = min(
        ground.area / max(length, 1e-6),
        shapely.LineString(left).distance(shapely.LineString(right)),
    )
    if width <= 0:
        return features
    points = np.asarray(shapely.LineString(line).simplify(BEND).coords)
    features += [
        Feature("lane", shapely.LineString(part), name, width=width, one_way=one_way)
        for part in itertools.pairwise(points)
    ]
    return features


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points (samples, 2) at equal distances along a line."""
    line = shapely.LineString(points)
    along = np.linspace(0, line.length, _SAMPLES)
    return shapely.get_coordinates(shapely.line_interpolate_point(line, along))
