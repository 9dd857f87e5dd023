"""OSM XML: maps of OpenStreetMap, and of Lanelet2 with its lanelets and spots."""

import dataclasses
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from carpark_mj.maps.features import (
    LINE_THICKNESS,
    Feature,
    Plan,
    Tag,
    lane_features,
    require_near,
    to_metres,
)
from carpark_mj.maps.tagged import add_by_tags
from carpark_mj.reading import read_bytes

Tags = dict[str, str]
MOST_PIECES = 500  # lines that form a polygon together
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
_SAMPLES = 9  # along a border


class Way(NamedTuple):
    """A line through nodes: its points (n, 2) [m], its tags, and whether it closes."""

    points: np.ndarray
    tags: Tags
    closed: bool

    @property
    def shape(self) -> Any:
        """A shapely polygon where it closes, or else a line."""
        if self.closed:
            return shapely.Polygon(self.points)
        return shapely.LineString(self.points)


class Relation(NamedTuple):
    """A relation: roles and ids of ways, and tags."""

    members: list[tuple[str, str]]
    tags: Tags


class OsmXml(NamedTuple):
    """The elements of a file by their ids, and the faults found in it."""

    nodes: dict[str, tuple[np.ndarray, Tags]]
    ways: dict[str, Way]
    relations: dict[str, Relation]
    faults: Counter[str]


def read_xml(path: Path) -> Any:
    """Reads the outermost element of an XML file; entities are refused.

    Raises:
        ValueError: not XML.
        OSError: the file cannot be read.
    """
    data = read_bytes(path)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise ValueError("maps in XML have no document type")
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"not XML ({error})") from None


def read_osm(root: Any) -> OsmXml:
    """Reads the element `osm` of a file.

    Raises:
        ValueError: invalid coordinates.
    """
    faults: Counter[str] = Counter()
    kept = [node for node in root.iter("node") if node.get("action") != "delete"]
    ids = [node.get("id", "") for node in kept]
    tags = [_tags(node) for node in kept]
    xy = _places(kept, tags)
    nodes = {i: (at, tag) for i, at, tag in zip(ids, xy, tags, strict=True)}
    ways = {}
    for way in root.iter("way"):
        if way.get("action") == "delete":
            continue
        refs = [nd.get("ref", "") for nd in way.iter("nd")]
        known = [ref for ref in refs if ref in nodes]
        if len(known) < len(refs):
            faults["reference to a missing node"] += len(refs) - len(known)
        steps = [
            ref for ref, last in zip(known, ["", *known], strict=False) if ref != last
        ]
        if len(steps) < 2:
            faults["way of fewer than two nodes"] += 1
            continue
        points = np.stack([nodes[ref][0] for ref in steps])
        # Programs also close a way with a second node in the first one's place.
        tags_of_way = _tags(way)
        closed = len(steps) > 3 and bool(np.ptp(points[[0, -1]], axis=0).max() < 1e-3)
        # Autoware's polygons do not come back to their first node.
        closed = closed or (len(steps) > 2 and tags_of_way.get("area") == "yes")
        ways[way.get("id", "")] = Way(points, tags_of_way, closed)
    relations = {
        relation.get("id", ""): Relation(
            [
                (member.get("role", ""), member.get("ref", ""))
                for member in relation.iter("member")
                if member.get("type") == "way"
            ],
            _tags(relation),
        )
        for relation in root.iter("relation")
        if relation.get("action") != "delete"
    }
    return OsmXml(nodes, ways, relations, faults)


def _tags(element: Any) -> Tags:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}


def _places(elements: list[Any], tags: list[Tags]) -> np.ndarray:
    """Coordinates (n, 2) [m]; `local_x`, `local_y` where every node has them."""
    if not elements:
        raise ValueError("the map has no node")
    local = all("local_x" in tag and "local_y" in tag for tag in tags)
    rows = []
    for element, tag in zip(elements, tags, strict=True):
        pair = (
            (tag["local_x"], tag["local_y"])
            if local
            else (element.get("lon"), element.get("lat"))
        )
        try:
            row = [float(number) for number in pair]
        except (TypeError, ValueError):
            row = [np.nan]
        if not np.isfinite(row).all():
            raise ValueError(
                f"node {element.get('id')} must have two numbers as its place, not "
                f"{pair[0]} and {pair[1]}"
            )
        rows.append(row)
    xy = np.array(rows)
    if not local:
        return to_metres(xy)
    xy -= (xy.min(axis=0) + xy.max(axis=0)) / 2
    require_near(xy)
    return xy


def joined(pieces: list[Any]) -> Any:
    """The polygon that lines form together; None if they do not, or are too many."""
    lines = [getattr(piece, "exterior", piece) for piece in pieces]
    if not 0 < len(lines) <= MOST_PIECES:
        return None
    rings: Any = shapely.polygonize([shapely.union_all(lines)]).geoms
    # What closes rings within each other is one polygon without holes.
    largest = max(rings, key=lambda ring: ring.area, default=None)
    return largest and shapely.Polygon(largest.exterior)


def osm_features(osm: OsmXml) -> Plan:
    """The features of a map of OpenStreetMap."""
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
    """The features of a Lanelet2 map."""
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
    return features + lane_features(name, shapely.LineString(line), width, one_way)


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points (samples, 2) at equal distances along a line."""
    line = shapely.LineString(points)
    along = np.linspace(0, line.length, _SAMPLES)
    return shapely.get_coordinates(shapely.line_interpolate_point(line, along))
