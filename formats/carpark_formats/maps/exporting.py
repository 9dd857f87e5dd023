"""Layouts as maps for other programs: OpenDRIVE 1.7 (`.xodr`), Lanelet2 (`.osm`).

- *OpenDRIVE*: every lane is a road. One more road, along x through the whole lot, has
  the objects: bays as `parkingSpace`, walls as `barrier`, islands as `trafficIsland`,
  discs as `pole`; names are the kinds.
- *Lanelet2*: lanes are lanelets, bays lines of type `parking_space` with a `width`,
  from their far end out into the aisle, walls lines of type `wall`, kerbs of
  `curbstone`, discs polygons of type `columns`, and where cars start is `parking_lot`.
  Nodes have `local_x`, `local_y` [m]; latitude and longitude are about 0, 0.

Neither has starts with their spreads, which end goes in first, or, in Lanelet2, kinds
of bays and the difference of walls, islands and gates.
"""

import math
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from carpark_mj.geometry import box_corners
from carpark_mj.layouts import types as lot
from carpark_mj.layouts.base import LAYOUT_WRITERS
from carpark_mj.layouts.build import swept_size
from carpark_mj.layouts.standards import DesignCar

PER_DEGREE = 110574.3, 111319.5  # m of latitude and longitude at 0, 0 in WGS84
EDGE = 1.0  # m beyond the extent, where the walls around a lot stand
POLE_HEIGHT = 2.5  # m, of a pillar [est]
CORNERS = 16  # of a disc's polygon
_ROAD = """<road name="{kind}" id="{number}" length="{length:.6f}" junction="-1">
<planView><geometry s="0" x="{x:.6f}" y="{y:.6f}" hdg="{yaw:.6f}" length="{length:.6f}">
<line/></geometry></planView><lanes><laneSection s="0">{left}<center><lane id="0"
 type="none" level="false"/></center>{right}</laneSection></lanes>{objects}</road>"""
_LANE = """<{side}><lane id="{place}" type="{kind}" level="false"><width sOffset="0"
 a="{width:.6f}" b="0" c="0" d="0"/></lane></{side}>"""
_OBJECT = """<object id="{number}" name="{name}" type="{kind}" s="{s:.6f}" t="{t:.6f}"
 hdg="{yaw:.6f}" zOffset="0" pitch="0" roll="0" orientation="none" {size}
 height="{height}">{more}</object>"""
_SPACE = """<parkingSpace access="{access}" restrictions="{kind}"/>"""


def xml_text(text: str) -> str:
    """The file of an XML element, indented."""
    root = ElementTree.fromstring(text)
    ElementTree.indent(root, " ")
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def opendrive_text(layout: lot.Layout) -> str:
    """A layout as OpenDRIVE."""
    x, y = np.asarray(layout.extent, float) + EDGE
    objects: list[str] = []

    def add(kind: str, name: str, pose: Any, size: Any, height: float, more: str = ""):
        at = {"s": pose[0] + x, "t": pose[1], "yaw": pose[2], "more": more}
        at |= {"number": len(objects), "height": height, "kind": kind}
        objects.append(_OBJECT.format(name=name.lower(), size=size, **at))

    def box(size: Any) -> str:
        return f'length="{size[0]:.6f}" width="{size[1]:.6f}"'

    for pose, size, kind in rows_of(layout, "bay", "pose", "size", "kind"):
        name, access = lot.BayKind(kind).name, "all"
        access = "handicapped" if kind == lot.BayKind.ACCESSIBLE else access
        note = "" if kind == lot.BayKind.STANDARD else name.lower()
        space = _SPACE.format(access=access, kind=note)
        add("parkingSpace", name, pose, box(size), 0.0, space)
    for pose, size, kind in rows_of(layout, "wall", "pose", "size", "kind"):
        what = "trafficIsland" if kind == lot.WallKind.ISLAND else "barrier"
        height = lot.KERB_HEIGHT if kind == lot.WallKind.KERB else lot.WALL_HEIGHT
        add(what, lot.WallKind(kind).name, pose, box(size), height)
    for centre, radius, kind in rows_of(layout, "disc", "centre", "radius", "kind"):
        tube = f'radius="{radius:.6f}"'
        add("pole", lot.DiscKind(kind).name, (*centre, 0.0), tube, POLE_HEIGHT)

    def road(
        number: int, start: Any, length: float, kind: str, left: float, right: Any
    ):
        lanes: dict[str, Any] = {"left": "", "right": ""}
        for side, place, width in (("left", 1, left), ("right", -1, right)):
            if width:
                same = {"side": side, "place": place, "kind": kind}
                lanes[side] = _LANE.format(width=width, **same)
        at = dict(zip(("x", "y", "yaw"), start, strict=True)) | lanes
        all_of_them = f"<objects>{''.join(objects)}</objects>"
        at |= {"objects": "" if number else all_of_them, "kind": kind}
        return _ROAD.format(number=number, length=length, **at)

    roads = [road(0, (-x, 0.0, 0.0), 2 * x, "parking", y, y)]
    for pose, size, one_way in rows_of(layout, "lane", "pose", "size", "one_way"):
        start = _turned(pose, (-size[0] / 2, size[1] / 2))
        kind = "driving" if one_way else "bidirectional"
        at = (*start, pose[2])
        roads.append(road(len(roads), at, size[0], kind, 0.0, size[1]))
    return xml_text(
        f'<OpenDRIVE><header revMajor="1" revMinor="7" name="lot" north="{y:.6f}" '
        f'south="{-y:.6f}" east="{x:.6f}" west="{-x:.6f}"/>{"".join(roads)}</OpenDRIVE>'
    )


def lanelet2_text(layout: lot.Layout) -> str:
    """A layout as OSM XML of Lanelet2."""
    nodes, ways, relations = list[str](), list[str](), list[str]()

    def new(kind: str, found: list[str], inside: str, place: str = "", **tags: Any):
        number = len(nodes) + len(ways) + len(relations) + 1
        inside += "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
        found.append(f'<{kind} id="{number}" version="1" {place}>{inside}</{kind}>')
        return number

    def way(points: Any, closed: bool = False, **tags: Any) -> int:
        refs = []
        for x, y in points:
            lat, lon = y / PER_DEGREE[0], x / PER_DEGREE[1]
            place = {"local_x": f"{x:.6f}", "local_y": f"{y:.6f}"}
            at = f'lat="{lat:.10f}" lon="{lon:.10f}"'
            refs.append(f'<nd ref="{new("node", nodes, "", at, **place)}"/>')
        return new("way", ways, "".join(refs + refs[: int(closed)]), **tags)

    for pose, size, one_way in rows_of(layout, "lane", "pose", "size", "one_way"):
        members = ""
        for side, sign in (("left", 1), ("right", -1)):
            points = axis(pose, size, sign * size[1] / 2)
            border = way(points, type="line_thin", subtype="dashed")
            members += f'<member type="way" ref="{border}" role="{side}"/>'
        tags = {"type": "lanelet", "subtype": "road", "location": "private"}
        tags |= {"one_way": "yes" if one_way else "no", "participant:vehicle": "yes"}
        new("relation", relations, members, **tags)
    for pose, size in rows_of(layout, "bay", "pose", "size"):
        way(axis(pose, size), type="parking_space", width=f"{size[1]:.6f}")
    for pose, size, kind in rows_of(layout, "wall", "pose", "size", "kind"):
        what = "curbstone" if kind == lot.WallKind.KERB else "wall"
        way(axis(pose, size), type=what, width=f"{size[1]:.6f}")
    angles = np.linspace(0.0, math.tau, CORNERS, endpoint=False)
    # As large as the disc.
    factor = math.sqrt(math.tau / (CORNERS * math.sin(math.tau / CORNERS)))
    for centre, radius in rows_of(layout, "disc", "centre", "radius"):
        ring = factor * radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        way(centre + ring, True, type="columns", area="yes")
    for pose, size in rows_of(layout, "spawn", "pose", "size"):
        ground = np.asarray(box_corners(pose, size + np.array(swept_size(DesignCar()))))
        way(ground, True, type="parking_lot", area="yes")
    return xml_text(f'<osm version="0.6">{"".join(nodes + ways + relations)}</osm>')


LAYOUT_WRITERS.register("xodr", opendrive_text)
LAYOUT_WRITERS.register("osm", lanelet2_text)


def rows_of(layout: lot.Layout, kind: str, *parts: str) -> Iterator[Any]:
    """The rows of a kind, `bay` or another of `ROWS`, with some of their fields."""
    mask = np.asarray(getattr(layout, f"{kind}_mask"))
    columns = (np.asarray(getattr(layout, f"{kind}_{part}"))[mask] for part in parts)
    return zip(*columns, strict=True)


def axis(pose: Any, size: Any, aside: float = 0.0) -> list[np.ndarray]:
    """The axis of a box along its heading, or a parallel so far to the left."""
    return [_turned(pose, (end * size[0] / 2, aside)) for end in (-1, 1)]


def _turned(pose: Any, local: tuple[float, float]) -> np.ndarray:
    """A point of the frame of a pose in the world's."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return pose[:2] + np.array([[cos, -sin], [sin, cos]]) @ np.array(local)
