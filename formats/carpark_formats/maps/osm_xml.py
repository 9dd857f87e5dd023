"""OSM XML: maps of OpenStreetMap, and of Lanelet2 with its lanelets and spots."""

import itertools
import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from carpark_formats.maps.features import (
    LINE_THICKNESS,
    Feature,
    Plan,
    Tag,
    centred,
    lane_features,
    to_metres,
)
from carpark_formats.maps.tagged import add_by_tags, add_tagged
from carpark_mj.reading import read_bytes

Tags = dict[str, str]
MOST_PIECES = 500  # lines that form a polygon together
# Subtypes and types in lower case; first what the Lanelet2 documents name, then what
# maps for valet parking have.
_WORDS: dict[Tag, str] = {
    "wall": "wall fence guard_rail building walls windows doors",
    "kerb": "curbstone kerbs",
    "pillar": "columns",
    "bay": "parking_space parking_spot",
    "drivable": "parking parking_lot parking_access junction",
}
_TAGS: dict[str, Tag] = {
    word: tag for tag, words in _WORDS.items() for word in words.split()
}
# Subtypes of lanelets that are not driven along.
_ON_FOOT = (
    *("crosswalk", "walkway", "shared_walkway"),
    *("stairs", "pedestrian_lane", "bicycle_lane"),
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
        return (shapely.Polygon if self.closed else shapely.LineString)(self.points)


class Relation(NamedTuple):
    """A relation: roles and ids of ways, and tags."""

    members: list[tuple[str, str]]
    tags: Tags


class OsmXml(NamedTuple):
    """The elements of a file by their ids."""

    nodes: dict[str, tuple[np.ndarray, Tags]]
    ways: dict[str, Way]
    relations: dict[str, Relation]

    def outline(self, relation: Relation) -> Any:
        """The polygon that the outer ways of a relation form together, or None."""
        outer = [way for role, way in relation.members if role != "inner"]
        return joined([self.ways[way].shape for way in outer])


def read_xml(path: Path) -> Any:
    """Reads the outermost element of an XML file; entities are refused."""
    data = read_bytes(path)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise ValueError("maps in XML have no document type")
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"not XML ({error})") from None


def read_number(text: str | None, what: str, most: float = math.inf) -> float:
    """The number in a text, at most so large; `ValueError` names what it is."""
    try:
        value = float("nothing" if text is None else text)
    except ValueError:
        value = math.nan
    if not abs(value) < most:
        kind = "a number" + f" within ±{most:g}" * math.isfinite(most)
        shown = "nothing" if text is None else repr(text.strip()[:40])
        raise ValueError(f"{what} must be {kind}, not {shown}")
    return value


def _read(root: Any, unknown: Counter[str]) -> OsmXml:
    """Reads the element `osm` of a file; what is missing in it counts as unknown."""

    def elements(kind: str) -> list[tuple[str, Any, Tags]]:
        kept = [one for one in root.iter(kind) if one.get("action") != "delete"]
        return [(one.get("id", ""), one, _tags(one)) for one in kept]

    found = elements("node")
    xy = _places(found)
    nodes = {name: (at, tags) for (name, _, tags), at in zip(found, xy, strict=True)}
    ways = {}
    for name, way, tags in elements("way"):
        refs = [nd.get("ref", "") for nd in way.iter("nd")]
        known = [ref for ref in refs if ref in nodes]
        if len(known) < len(refs):
            unknown["reference to a missing node"] += len(refs) - len(known)
        steps = [ref for ref, _ in itertools.groupby(known)]
        if len(steps) < 2:
            unknown["way of fewer than two nodes"] += 1
            continue
        points = np.stack([nodes[ref][0] for ref in steps])
        # Programs also close a way with a second node in the first one's place.
        closed = len(steps) > 3 and bool(np.ptp(points[[0, -1]], axis=0).max() < 1e-3)
        # Autoware's polygons do not come back to their first node.
        closed = closed or (len(steps) > 2 and tags.get("area") == "yes")
        ways[name] = Way(points, tags, closed)
    relations = {}
    for name, relation, tags in elements("relation"):
        members = [
            (member.get("role", ""), member.get("ref", ""))
            for member in relation.iter("member")
            if member.get("type") == "way" and member.get("ref") in ways
        ]
        relations[name] = Relation(members, tags)
    return OsmXml(nodes, ways, relations)


def _tags(element: Any) -> Tags:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iter("tag")}


def _places(nodes: list[tuple[str, Any, Tags]]) -> np.ndarray:
    """Coordinates (n, 2) [m]; `local_x`, `local_y` where every node has them."""
    if not nodes:
        raise ValueError("the map has no node")
    local = all("local_x" in tags and "local_y" in tags for _, _, tags in nodes)
    names = ("local_x", "local_y") if local else ("lon", "lat")
    rows = []
    for name, element, tags in nodes:
        source: Any = tags if local else element
        pair = [source.get(part) for part in names]
        try:
            rows.append([float(number) for number in pair])
        except (TypeError, ValueError):
            places = " and ".join(map(str, pair))
            raise ValueError(
                f"node {name} must have two numbers as its place, not {places}"
            ) from None
    return centred(np.array(rows)) if local else to_metres(np.array(rows))


def joined(pieces: list[Any]) -> Any:
    """The polygon that lines form together; None if they do not, or are too many."""
    lines = [getattr(piece, "exterior", piece) for piece in pieces]
    if not 0 < len(lines) <= MOST_PIECES:
        return None
    rings: Any = shapely.polygonize([shapely.union_all(lines)]).geoms
    # What closes rings within each other is one polygon without holes.
    largest = max(rings, key=lambda ring: ring.area, default=None)
    return largest and shapely.Polygon(largest.exterior)


def osm_features(root: Any) -> Plan:
    """The features of an element `osm`: of a Lanelet2 map, or one of OpenStreetMap."""
    plan = Plan()
    osm = _read(root, plan.report.unknown)
    tags = [one.tags for one in (*osm.relations.values(), *osm.ways.values())]
    is_lanelet2 = any(
        one.get("type") == "lanelet" or _tag(one) == "bay"
        for one in tags
        if "amenity" not in one
    )
    (_add_lanelet2 if is_lanelet2 else _add_openstreetmap)(plan, osm)
    return plan


def _add_openstreetmap(plan: Plan, osm: OsmXml) -> None:
    used: set[str] = set()
    for name, relation in osm.relations.items():
        if (kind := relation.tags.get("type", "without a type")) != "multipolygon":
            plan.report.unknown[f"relation {kind}"] += 1
        # Older maps have the tags on the outer way.
        elif any(key in relation.tags for key in ("amenity", "building", "barrier")):
            used.update(way for role, way in relation.members if role != "inner")
            add_by_tags(plan, name, relation.tags, osm.outline(relation))
    for name, way in osm.ways.items():
        if name not in used:
            add_by_tags(plan, name, way.tags, way.shape)
    for name, (place, tags) in osm.nodes.items():
        if tags:
            add_by_tags(plan, name, tags, shapely.Point(place))


def _tag(tags: Tags) -> Tag | None:
    """Tag of an element of Lanelet2 by its subtype, or else by its type."""
    for key in ("subtype", "type"):
        if found := _TAGS.get(tags.get(key, "").lower()):
            return found
    return None


def _add_lanelet2(plan: Plan, osm: OsmXml) -> None:
    used: set[str] = set()
    for name, relation in osm.relations.items():
        tags = relation.tags
        kind = tags.get("subtype") or tags.get("type") or "without a type"
        if tags.get("type") == "lanelet":
            if tags.get("subtype") in _ON_FOOT:
                plan.report.unknown[f"lanelet {kind}"] += 1
                continue
            borders = {role: osm.ways[way].points for role, way in relation.members}
            one_way, level = tags.get("one_way", "yes") != "no", tags.get("level", "")
            add_lanelet(plan, name, borders, one_way, level)
        elif _tag(tags) in ("bay", "drivable"):
            used.update(way for _, way in relation.members)
            _add(plan, name, tags, osm.outline(relation))
        else:
            plan.report.unknown[f"relation {kind}"] += 1
    for name, way in osm.ways.items():
        # Others are pieces of a spot or borders of lanelets.
        if name not in used and (way.tags.get("type") or way.tags.get("subtype")):
            _add(plan, name, way.tags, _shape(way))


def _add(plan: Plan, name: str, tags: Tags, shape: Any) -> None:
    word = tags.get("subtype") or tags.get("type", "")
    if tag := _tag(tags):
        add_tagged(plan, name, shape, {"tag": tag, "level": tags.get("level")}, word)
    else:
        plan.report.unknown[word] += 1


def _shape(way: Way) -> Any:
    """The polygon of a way; a line has its own width, or that of a wall."""
    is_line, shape = _tag(way.tags) in ("wall", "kerb"), way.shape
    if way.closed:
        if not is_line or way.tags.get("type", "area") == "area":
            return shape
        shape = shape.exterior  # a closed line surrounds its ground
    try:
        width = float(way.tags["width"])
    except (KeyError, ValueError):
        if not is_line:
            return None
        width = LINE_THICKNESS
    width = width if 0 < width < 100 else LINE_THICKNESS
    return shape.buffer(width / 2, cap_style="flat", join_style="mitre")


def add_lanelet(
    plan: Plan,
    name: str,
    borders: Mapping[str, np.ndarray],
    one_way: bool,
    level: str = "",
) -> None:
    """Adds the straight lanes of a lanelet, and the ground that it covers.

    Its borders are points (n, 2) of `left` and `right` [m], two at least.
    """
    ground: Any = shapely.Polygon()
    left, right = (borders.get(side, np.zeros((0, 2))) for side in ("left", "right"))
    if len(left) and len(right):
        ends = [shapely.LineString([left[i], right[i]]) for i in (0, -1)]
        if ends[0].intersects(ends[1]):
            right = right[::-1]
        ground = shapely.LinearRing(np.concatenate([left, right[::-1]]))
        if ground.is_ccw:  # drawn against the direction of travel
            left, right = left[::-1], right[::-1]
        ground = shapely.make_valid(shapely.Polygon(ground))
    if not ground.area:
        plan.report.unknown["lanelet without two borders"] += 1
        return
    plan.features.append(Feature("drivable", ground, name, level=level))
    line = (_sampled(left) + _sampled(right)) / 2
    steps = np.diff(line, axis=0)
    turned = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    length = float(np.hypot(*steps.T).sum())
    apart = shapely.LineString(left).distance(shapely.LineString(right))
    width = min(ground.area / max(length, 1e-6), apart)
    if width > 0 and not (np.ptp(turned) > TURN and length < SHORT):
        line = shapely.LineString(line)
        plan.features.extend(lane_features(name, line, width, one_way, level))


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points (samples, 2) at equal distances along a line."""
    line = shapely.LineString(points)
    along = np.linspace(0, line.length, _SAMPLES)
    return shapely.get_coordinates(shapely.line_interpolate_point(line, along))
