"""A lot of six bays, a lane and a wall as the text of a map in every format."""

import io
import json
import math

import numpy as np

LON, LAT, TURN = 11.5, 48.1, 0.6  # where the lot lies and how it is turned
TURNED = np.array([[math.cos(TURN), math.sin(TURN)], [-math.sin(TURN), math.cos(TURN)]])
LENGTH, WIDTH, COUNT = 5.0, 2.5, 6
RADIUS = 6_378_137.0  # m, of the equator


def rectangle(left, low, right, high):
    return [(left, low), (right, low), (right, high), (left, high), (left, low)]


BAYS = [rectangle(WIDTH * k, 3, WIDTH * (k + 1), 8) for k in range(COUNT)]
WALL = rectangle(0, 8.3, WIDTH * COUNT, 8.5)
LANE, LANE_WIDTH = [(-2, 0), (17, 0)], 5.5
FAR = rectangle(300, 300, 310, 310)


def geographic(points):
    """Longitude and latitude of points of the lot, by the ellipsoid's two radii."""
    x, y = (np.array(points, float) @ TURNED).T
    e2, sine = 0.00669438, math.sin(math.radians(LAT))
    across = RADIUS / math.sqrt(1 - e2 * sine**2)
    along = across * (1 - e2) / (1 - e2 * sine**2)
    lon = LON + np.degrees(x / (across * math.cos(math.radians(LAT))))
    return np.stack([lon, LAT + np.degrees(y / along)], axis=-1).tolist()


def osm_xml(shapes):
    """OSM XML of (points, tags, pieces): a shape in pieces is joined by a relation.

    One point is a node with tags.
    """
    nodes, ways, relations = [], [], []
    for points, tags, pieces in shapes:
        rows = "".join(f"<tag k='{k}' v='{v}'/>" for k, v in tags.items())
        first = len(nodes) + 1
        inner = rows if len(points) == 1 else ""
        nodes += [
            f"<node id='{first + k}' lon='{lon!r}' lat='{lat!r}'>{inner}</node>"
            for k, (lon, lat) in enumerate(geographic(points))
        ]
        if len(points) == 1:
            continue
        refs = [*range(first, len(nodes) + 1)]
        cut = len(refs) - 2
        parts = [refs[: cut + 1], refs[cut:]] if pieces else [refs]
        members = []
        for part in parts:
            members.append(
                f"<member type='way' role='outer' ref='{9000 + len(ways)}'/>"
            )
            inner = "".join(f"<nd ref='{ref}'/>" for ref in part)
            ways.append(f"<way id='{9000 + len(ways)}'>{inner}{rows}</way>")
        if pieces:
            more = rows + "<tag k='type' v='multipolygon'/>"
            relations.append(
                f"<relation id='{first}'>{''.join(members)}{more}</relation>"
            )
    return "<osm>" + "\n".join([*nodes, *ways, *relations]) + "</osm>"


def openstreetmap(bays=BAYS):
    space = {"amenity": "parking_space"}
    return osm_xml(
        [
            *((bay, space, False) for bay in bays),
            (WALL, {"barrier": "wall", "area": "yes"}, False),
            (LANE, {"highway": "service", "width": LANE_WIDTH, "oneway": "-1"}, False),
            (FAR, {"building": "yes"}, False),
            ([(0, 0), (1, 1)], {"power": "line"}, False),
        ]
    )


def lanelet2(bays=BAYS):
    half = LANE_WIDTH / 2
    text = osm_xml(
        [
            *((bay, {"subtype": "parking_spot"}, True) for bay in bays),
            (WALL, {"type": "area", "subtype": "Walls"}, False),
            ([(17, half), (-2, half)], {}, False),
            ([(17, -half), (-2, -half)], {}, False),
            (FAR, {"type": "area", "subtype": "Walls"}, False),
            (FAR, {"type": "area", "subtype": "power"}, False),
        ]
    )
    # Driven from right to left, so its left border is the lower one.
    low, high = 9000 + 2 * len(bays) + 2, 9000 + 2 * len(bays) + 1
    lane = (
        f"<relation id='0'><member type='way' role='left' ref='{low}'/>"
        f"<member type='way' role='right' ref='{high}'/>"
        "<tag k='type' v='lanelet'/></relation></osm>"
    )
    return text.replace("</osm>", lane)


def commonroad(bays=BAYS):
    """A scenario whose goals are the bays; a car starts in the lane for each."""

    def points(line):
        rows = np.array(line, float) @ TURNED + (3000.0, -500.0)
        return "".join(
            f"<point><x>{x!r}</x><y>{y!r}</y></point>" for x, y in rows.tolist()
        )

    def state(at, yaw):
        return (
            f"<initialState><position>{points([at])}</position><orientation>"
            f"<exact>{yaw + TURN}</exact></orientation></initialState>"
        )

    def wall(number, box):
        (left, low), (right, high) = box[0], box[2]
        middle = (left + right) / 2, (low + high) / 2
        return (
            f"<staticObstacle id='{number}'><type>building</type><shape><rectangle>"
            f"<length>{high - low}</length><width>{right - left}</width></rectangle>"
            f"</shape>{state(middle, math.pi / 2)}</staticObstacle>"
        )

    half = LANE_WIDTH / 2
    lane = (
        f"<lanelet id='1'><leftBound>{points([(17, -half), (-2, -half)])}</leftBound>"
        f"<rightBound>{points([(17, half), (-2, half)])}</rightBound></lanelet>"
    )
    problems = "".join(
        f"<planningProblem id='{10 + k}'>{state((2 + 2 * k, 0), math.pi)}<goalState>"
        f"<position><polygon>{points(bay[:-1])}</polygon></position></goalState>"
        "</planningProblem>"
        for k, bay in enumerate(bays)
    )
    return (
        f"<commonRoad commonRoadVersion='2020a'>{lane}{wall(2, WALL)}{wall(3, FAR)}"
        f"<power/>{problems}</commonRoad>"
    )


def geojson(bays=BAYS):
    def feature(kind, points, **properties):
        places = geographic(points)
        return {
            "type": "Feature",
            "properties": properties,
            "geometry": {
                "type": kind,
                "coordinates": [places] if kind == "Polygon" else places,
            },
        }

    lane = {"tag": "lane", "width": LANE_WIDTH, "one_way": True}
    return {
        "type": "FeatureCollection",
        "features": [
            *(feature("Polygon", bay, tag="bay") for bay in bays),
            feature("Polygon", WALL, tag="wall"),
            feature("LineString", LANE[::-1], **lane),
            feature("Polygon", FAR, tag="wall"),
            feature("Polygon", FAR, tag="power"),
        ],
    }


def dxf(bays=BAYS, units=4):
    """A drawing in millimetres, its bays blocks that were inserted."""
    import ezdxf

    drawing = ezdxf.new("R2000", units=units)
    model, block = drawing.modelspace(), drawing.blocks.new("BAY")
    outline = [(0, 0), (1000 * WIDTH, 0), (1000 * WIDTH, 5000), (0, 5000)]
    block.add_lwpolyline(outline, close=True)
    turned = math.degrees(TURN)

    def at(points):
        return [ezdxf.math.Vec2(p).rotate(TURN) * 1000 for p in points]

    for bay in bays:
        [corner] = at(bay[:1])
        model.add_blockref("BAY", corner, {"layer": "Parking bays", "rotation": turned})
    model.add_lwpolyline(at(WALL[:-1]), close=True, dxfattribs={"layer": "A-WALL-EXTR"})
    model.add_lwpolyline(at(FAR[:-1]), close=True, dxfattribs={"layer": "A-WALL-EXTR"})
    model.add_lwpolyline(
        at(LANE[::-1]),
        dxfattribs={"layer": "LANES_ONE_WAY", "const_width": 1000 * LANE_WIDTH},
    )
    model.add_line((0, 0), (1, 1), {"layer": "power"})
    text = io.StringIO()
    drawing.write(text)
    return text.getvalue()


TEXTS = {
    "lanelet2.osm": lanelet2,
    "openstreetmap.osm": openstreetmap,
    "commonroad.xml": commonroad,
    "lot.geojson": lambda bays=BAYS: json.dumps(geojson(bays)),
    "lot.dxf": dxf,
}


def write(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path
