"""OSM XML: nodes, ways and relations with tags, of OpenStreetMap and of Lanelet2."""

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import shapely

from carpark_mj.maps.frame import require_near, to_metres
from carpark_mj.reading import read_bytes

Tags = dict[str, str]
MOST_PIECES = 500  # lines that form a polygon together


@dataclasses.dataclass(frozen=True)
class Way:
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


@dataclasses.dataclass(frozen=True)
class Relation:
    """Ways by their role, tags, and the number of other or missing members."""

    members: list[tuple[str, str]]
    tags: Tags


@dataclasses.dataclass(frozen=True)
class OsmXml:
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
    """The polygon that lines form together; None if they do not, or are too many.

    Args:
        pieces: shapely lines and polygons.
    """
    lines = [getattr(piece, "exterior", piece) for piece in pieces]
    if not 0 < len(lines) <= MOST_PIECES:
        return None
    rings: Any = shapely.polygonize([shapely.union_all(lines)]).geoms
    # What closes rings within each other is one polygon without holes.
    largest = max(rings, key=lambda ring: ring.area, default=None)
    return largest and shapely.Polygon(largest.exterior)
