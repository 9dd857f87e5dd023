"""Maps become layouts: a known lot comes back from every format, faults are refused."""

import io
import json
import math
import sys

import numpy as np
import pytest
import shapely
from helpers.mutating import damaged, with_junk
from shapely import affinity

from carpark_mj.cli.layouts import main
from carpark_mj.layouts.json_file import read_json
from carpark_mj.layouts.types import BayKind

pytest.importorskip("pyproj")
pytest.importorskip("ezdxf")

from carpark_mj.maps import assemble as assembling
from carpark_mj.maps.fit import boxes, cut_free
from carpark_mj.maps.importing import import_map

LON, LAT, TURN = 11.5, 48.1, 0.6  # where the lot lies and how it is turned
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
    turn = np.array(
        [[math.cos(TURN), math.sin(TURN)], [-math.sin(TURN), math.cos(TURN)]]
    )
    x, y = (np.array(points, float) @ turn).T
    e2, sine = 0.00669438, math.sin(math.radians(LAT))
    across = RADIUS / math.sqrt(1 - e2 * sine**2)
    along = across * (1 - e2) / (1 - e2 * sine**2)
    lon = LON + np.degrees(x / (across * math.cos(math.radians(LAT))))
    return np.stack([lon, LAT + np.degrees(y / along)], axis=-1).tolist()


def osm_xml(shapes):
    """OSM XML of (points, tags, pieces): a shape in pieces is joined by a relation."""
    nodes, ways, relations = [], [], []
    for points, tags, pieces in shapes:
        rows = "".join(f"<tag k='{k}' v='{v}'/>" for k, v in tags.items())
        first = len(nodes) + 1
        nodes += [
            f"<node id='{first + k}' lon='{lon!r}' lat='{lat!r}'/>"
            for k, (lon, lat) in enumerate(geographic(points))
        ]
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
    turn = np.array(
        [[math.cos(TURN), math.sin(TURN)], [-math.sin(TURN), math.cos(TURN)]]
    )

    def points(line):
        rows = np.array(line, float) @ turn + (3000.0, -500.0)
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


@pytest.mark.parametrize("name", TEXTS)
def test_a_known_lot_comes_back_from_every_format(tmp_path, capsys, name):
    path, out = write(tmp_path, name, TEXTS[name]()), tmp_path / "lot.json"
    assert main(["import", str(path), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "6 of 6 spots" in told
    assert "1 wall" in told  # the building far away
    assert "power" in told  # not understood
    lot = read_json(out)
    assert np.allclose(lot.bay_size, (LENGTH, WIDTH), atol=0.02)
    # Headings and places but for a rigid motion: bays, wall and lane as drawn.
    centres = np.concatenate(
        [lot.bay_pose[:, :2], lot.wall_pose[:, :2], lot.lane_pose[:, :2]]
    )
    drawn = np.array(
        [*((WIDTH * (k + 0.5), 5.5) for k in range(COUNT)), (7.5, 8.4), (7.5, 0.0)]
    )
    assert np.allclose(
        np.linalg.norm(centres[:, None] - centres, axis=-1),
        np.linalg.norm(drawn[:, None] - drawn, axis=-1),
        atol=0.05,
    )
    [lane], [size] = np.asarray(lot.lane_pose), np.asarray(lot.lane_size)
    assert bool(lot.lane_one_way.all())
    assert np.allclose(size, (19, LANE_WIDTH), atol=0.05)
    # Bays head out into the lane, which runs to the left of cars that leave them.
    turn = np.exp(1j * (lane[2] - np.asarray(lot.bay_pose)[:, 2]))
    assert np.allclose(turn, -1j, atol=0.01)


def test_a_projected_system_gives_the_same_lot(tmp_path):
    import pyproj

    data = geojson()
    project = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:25832", always_xy=True)
    for feature in data["features"]:
        geometry = shapely.from_geojson(json.dumps(feature["geometry"]))
        moved = shapely.transform(geometry, project.transform, interleaved=False)
        feature["geometry"] = json.loads(shapely.to_geojson(moved))
    data["crs"] = {"properties": {"name": "EPSG:25832"}}
    one, _ = import_map(write(tmp_path, "one.geojson", json.dumps(geojson())))
    other, _ = import_map(write(tmp_path, "two.geojson", json.dumps(data)))
    assert np.allclose(one.bay_size, other.bay_size, atol=1e-3)
    # Its grid's north is another one, and the lot is turned to its rows.
    assert np.allclose(one.bay_pose, other.bay_pose, atol=1e-2)


def test_cars_of_a_scenario_start_in_their_headings(tmp_path):
    lot, _ = import_map(write(tmp_path, "commonroad.xml", commonroad()))
    [lane] = np.asarray(lot.lane_pose)
    starts = np.asarray(lot.spawn_pose)
    assert len(starts) == COUNT + 1  # and the lane
    assert np.allclose(np.cos(starts[:, 2] - lane[2]), 1.0, atol=1e-3)


def test_the_shapes_of_a_scenario_keep_their_kinds(tmp_path):
    # Beside the lane, whose line is y = 0 of the drawing.
    x, y = 3000.0 + 3.3 * math.sin(TURN), -500.0 - 3.3 * math.cos(TURN)
    pillar = (
        f"<staticObstacle id='7'><type>pillar</type><shape><circle><radius>0.3</radius>"
        "<center><x>1</x><y>0</y></center></circle></shape><initialState><position>"
        f"<point><x>{x}</x><y>{y}</y></point></position><orientation><intervalStart>"
        "0.5</intervalStart><intervalEnd>0.7</intervalEnd></orientation></initialState>"
        "</staticObstacle></commonRoad>"
    )
    text = commonroad().replace("</commonRoad>", pillar)
    both_ways = "</rightBound><userBidirectional>car</userBidirectional>"
    text = text.replace("</rightBound>", both_ways)
    lot, _ = import_map(write(tmp_path, "commonroad.xml", text))
    assert not lot.lane_one_way.any()
    assert np.asarray(lot.disc_radius)[lot.disc_mask] == pytest.approx(0.3, rel=0.02)
    [lane], [disc] = np.asarray(lot.lane_pose), np.asarray(lot.disc_centre)
    away = disc - lane[:2]
    across = away[1] * np.cos(lane[2]) - away[0] * np.sin(lane[2])
    assert abs(across) == pytest.approx(3.3, abs=0.01)


BROKEN = {
    "no XML": ("a.osm", "<osm><node", "not XML"),
    "entities": ("a.osm", "<!DOCTYPE osm><osm/>", "document type"),
    "another root": ("a.osm", "<svg/>", "outermost"),
    "no node": ("a.osm", "<osm/>", "no node"),
    "no place": ("a.osm", "<osm><node id='1' lat='x' lon='2'/></osm>", "node 1"),
    "no number": (
        "a.xml",
        "<commonRoad><lanelet><leftBound><point><x>1</x></point></leftBound></lanelet>"
        "</commonRoad>",
        "y must be a number within",
    ),
    "a far scenario": (
        "a.xml",
        commonroad([*BAYS, rectangle(2500, 0, 2505, 2)]),
        "at most 2 km",
    ),
    "no scenario": ("a.xml", "<commonRoad/>", "no parking spot"),
    "no spot": ("a.osm", openstreetmap([]), "no parking spot"),
    "no lane": (
        "a.osm",
        openstreetmap().replace("service", "footway"),
        "no lane, aisle or start",
    ),
    "too many spots": ("a.osm", openstreetmap(BAYS * 84), "504 spots; at most 500"),
    "too large": (
        "a.osm",
        openstreetmap([*BAYS, rectangle(2500, 0, 2505, 2)]),
        "at most 2 km",
    ),
    "small spots": (
        "a.osm",
        openstreetmap([rectangle(0, 3, 2, 5)]),
        "smaller than the car",
    ),
    "no collection": ("a.geojson", "{}", "features"),
    "no geometry": (
        "a.geojson",
        json.dumps({"features": [{"properties": {}, "geometry": None}]}),
        "geometry",
    ),
    "unknown system": (
        "a.geojson",
        json.dumps(geojson() | {"crs": {"properties": {"name": "EPSG:0"}}}),
        "EPSG:0",
    ),
    "no DXF": ("a.dxf", "0\nSECTION\n", "no DXF"),
    "no unit": ("a.dxf", dxf(units=0), "$INSUNITS"),
    "another format": ("a.svg", "", ".geojson"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_what_is_no_map_is_refused_in_one_sentence(tmp_path, capsys, fault):
    name, text, told = BROKEN[fault]
    path = write(tmp_path, name, text)
    out = tmp_path / "lot.json"
    assert main(["import", str(path), "--out", str(out)]) == 2
    error = capsys.readouterr().err.strip()
    assert told in error
    assert str(path) in error
    assert "\n" not in error
    assert not out.exists()


def test_a_missing_library_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    monkeypatch.delitem(sys.modules, "carpark_mj.maps.dxf", raising=False)
    path = write(tmp_path, "a.dxf", "")
    assert main(["import", str(path), "--out", str(tmp_path / "lot.json")]) == 2
    assert "maps need ezdxf: pip install" in capsys.readouterr().err


@pytest.mark.parametrize("name", TEXTS)
def test_damaged_maps_are_imported_or_refused(tmp_path, monkeypatch, name):
    # A lot of every size would be compiled on its own.
    monkeypatch.setattr(assembling, "_layout", lambda *parts: parts)
    monkeypatch.setattr(assembling, "describe_faults", lambda layout: [])
    refused = 0
    for seed in range(100):
        if name.endswith(".geojson") and seed % 2:
            data = json.dumps(with_junk(geojson(), seed)).encode()
        else:
            data = damaged(TEXTS[name]().encode(), seed)
        path = tmp_path / name
        path.write_bytes(data)
        try:
            _, report = import_map(path)
        except ValueError as error:
            told = str(error)
            refused += 1
        else:
            assert len(report.errors) + len(report.lost) == report.spots
            told = f"{path}: {report.spots}"
        assert told.startswith(f"{path}: ")
        assert "\n" not in told
    assert 0 < refused < 100


def test_spots_that_are_no_bays_are_told_with_the_reason(tmp_path):
    odd = [
        [(20, 3), (26, 3), (20, 9), (20, 3)],  # a triangle
        BAYS[0],  # drawn twice
        rectangle(0, 60, 2.5, 65),  # far from the lane
    ]
    plan = write(tmp_path, "odd.osm", openstreetmap(BAYS + odd))
    _, report = import_map(plan)
    assert report.spots == COUNT + len(odd)
    reasons = list(report.lost.values())
    assert [why.split()[0] for why in reasons] == ["no", "covered", "more"]


def test_a_spot_a_little_too_short_is_lengthened_into_the_aisle(tmp_path):
    short = rectangle(20, 3, 22.5, 7.18)
    lot, report = import_map(write(tmp_path, "a.osm", openstreetmap([*BAYS, short])))
    assert len(report.stretched) == 1
    assert report.stretched[0] in str(report)
    assert np.asarray(lot.bay_kind).tolist() == [*[0] * COUNT, BayKind.RESERVED]
    # Its end away from the lane, whose line is y = 0 of the drawing, stays.
    [lane] = np.asarray(lot.lane_pose)
    aside = np.array([-math.sin(lane[2]), math.cos(lane[2])])
    away = np.abs((np.asarray(lot.bay_pose)[:, :2] - lane[:2]) @ aside)
    back = away + np.asarray(lot.bay_size)[:, 0] / 2
    assert np.allclose(back, [*[8.0] * COUNT, 7.18], atol=0.03)


SHAPES = {
    "L": shapely.box(0, 0, 10, 1).union(shapely.box(0, 0, 1, 8)),
    "ring": shapely.box(0, 0, 10, 8).difference(shapely.box(1, 1, 9, 7)),
    "arc": shapely.Point(0, 0).buffer(10).boundary.buffer(0.5),
    "triangle": shapely.Polygon([(0, 0), (10, 0), (0, 5)]),
}


@pytest.mark.parametrize("name", SHAPES)
def test_rectangles_cover_a_polygon_and_little_else(name):
    shape = SHAPES[name]
    cover = shapely.union_all([box.shape for box in boxes(shape)])
    assert shape.difference(cover).area < 1e-3
    assert cover.difference(shape.buffer(0.8)).area == 0


@pytest.mark.parametrize("turn", [0.0, 0.6, 1.1, 1.9, 2.6, 3.7])
def test_right_angles_are_cut_at_their_corners(turn):
    stair = SHAPES["L"].union(shapely.box(-6, 7, 1, 8))
    shape = affinity.rotate(stair, turn, use_radians=True)
    assert len([*boxes(shape)]) == 3


def test_a_rectangle_cut_free_keeps_the_most_that_it_can():
    [box] = boxes(shapely.box(0, 0, 10, 4))
    free = cut_free(box, [shapely.box(-5, 3.5, 20, 9), shapely.box(9, 0, 12, 1)])
    assert free is not None
    assert free.shape.area == pytest.approx(9 * 3.5, rel=0.01)
    assert cut_free(box, [shapely.box(-1, -1, 11, 5)]) is None
