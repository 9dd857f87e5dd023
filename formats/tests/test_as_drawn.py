"""Maps as people draw them: leaning spots, spots by number, levels, outlines, fits."""

import itertools
import json
import math

import numpy as np
import pytest
import shapely
from helpers.programs import layouts as main
from map_texts import (
    BAYS,
    COUNT,
    LANE,
    LENGTH,
    WIDTH,
    geojson,
    lanelet2,
    osm_xml,
    rectangle,
    write,
)
from shapely import affinity

from carpark_formats.maps import importing as assembling
from carpark_formats.maps.fit import boxes, cut_free
from carpark_formats.maps.importing import import_map

SPOT = {"amenity": "parking_space"}
ROAD = {"highway": "service"}


@pytest.fixture
def imported(tmp_path, monkeypatch):
    """Imports shapes without compiling a lot: bays, starts and the report."""
    monkeypatch.setattr(assembling, "_layout", lambda *parts: (parts, (0.0, 0.0)))
    monkeypatch.setattr(assembling, "describe_faults", lambda layout: [])

    def read(shapes, **flags):
        rows = [(*shape, False) for shape in shapes]
        (bays, _, _, _, starts), report = import_map(
            write(tmp_path, "a.osm", osm_xml(rows)), **flags
        )
        return [box for box, _ in bays], starts, report

    return read


def leaning(angle, side, near, up=1, count=COUNT):
    """Spots between lines of a length at an angle to the road, `WIDTH` apart."""
    step = WIDTH / math.sin(angle)
    x, y = side * math.cos(angle), side * math.sin(angle)
    rows = []
    for a, b in itertools.pairwise(step * k for k in range(count + 1)):
        ring = (a, near), (b, near), (b + x, near + y), (a + x, near + y), (a, near)
        rows.append([(u, up * v) for u, v in ring])
    return rows


@pytest.mark.parametrize("degrees", [30, 45, 60, 75, 90])
def test_a_leaning_spot_is_the_bay_between_its_long_sides(imported, degrees):
    angle = math.radians(degrees)
    full = LENGTH + WIDTH / math.tan(angle)  # whose outline holds the whole bay
    for side in (LENGTH, full):
        # Two rows back to back, each with a road of its own.
        depth = side * math.sin(angle)
        rows = leaning(angle, side, 0.0) + leaning(angle, side, 0.0, up=-1)
        roads = [[(-9, y), (40, y)] for y in (depth + 3, -depth - 3)]
        shapes = [(spot, SPOT) for spot in rows] + [(road, ROAD) for road in roads]
        bays, _, report = imported(shapes)
        assert len(bays) == len(rows), report
        sizes = np.array([box.size for box in bays])
        assert np.allclose(sizes[:, 1], WIDTH, atol=0.02)
        assert (sizes[:, 0] > 4.3).all()
        assert (sizes[:, 0] < LENGTH + 0.02).all()
        turns = np.array([box.yaw - report.turned for box in bays]) - 0.6
        along = np.minimum(abs(np.sin(turns - angle)), abs(np.sin(turns + angle)))
        assert np.allclose(along, 0.0, atol=0.01)
        for one, other in itertools.combinations([box.shape for box in bays], 2):
            assert one.intersection(other).area < 0.01
        if side == full:
            assert np.allclose(sizes[:, 0], LENGTH, atol=0.02)
            # The corners of the outline that stand out are all that is left of it.
            assert np.allclose(report.errors, WIDTH / math.tan(angle), atol=0.03)


def test_spots_by_number_become_rows(imported):
    street = {"amenity": "parking", "parking": "street_side"}
    shapes = [
        (rectangle(0, 3, 20, 8), SPOT | {"capacity": "8"}),
        (rectangle(0, -5, 18, -3), street | {"orientation": "parallel"}),
        (rectangle(22, 3, 29.5, 8), street | {"orientation": "perpendicular"}),
        (rectangle(31, 3, 36, 23), {"amenity": "parking", "capacity": "8"}),
        ([(-9, 0), (40, 0), (40, 30)], ROAD),
    ]
    bays, _, report = imported(shapes)
    assert "diagonal" not in str(report)
    sizes = sorted(tuple(np.round(box.size, 1).tolist()) for box in bays)
    assert sizes == [(5.0, 2.5)] * 19 + [(6.0, 2.0)] * 3
    assert "8 of 8" in str(report)
    # Tags have no angle, which the report says.
    row = SPOT | {"capacity": "4", "orientation": "diagonal"}
    _, _, report = imported([(rectangle(0, 3, 10, 8), row), ([(-9, 0), (40, 0)], ROAD)])
    assert "diagonal" in str(report)


def test_spots_beside_aisles_fill_a_car_park(imported):
    area = rectangle(0, 0, 32, 34)
    aisles = [[(8, -6), (8, 30)], [(24, -6), (24, 30)], [(-9, -6), (40, -6)]]
    shapes = [(line, ROAD) for line in aisles]
    shapes += [(area, {"amenity": "parking"})]
    bays, _, _ = imported(shapes)
    # Four rows of twelve, as in a plan of 16 m modules: 5 + 6 + 5.
    assert len(bays) == 48
    some, _, report = imported([*shapes[:-1], (area, shapes[-1][1] | {"capacity": 9})])
    assert len(some) == 9
    assert "9 of 9" in str(report)
    # Drawn spots count alone.
    drawn, _, report = imported([*shapes, (rectangle(0, 2, 5, 4.5), SPOT)])
    assert len(drawn) == report.spots == 1


def test_spots_in_a_row_or_below_the_ground_count_once(imported):
    # As in Bratislava: a row beside the street, one of its spots drawn as accessible.
    row = {"amenity": "parking", "parking": "street_side", "capacity": "6"}
    shapes = [(rectangle(0, 3, 15, 8), row), (BAYS[2], SPOT | {"wheelchair": "yes"})]
    bays, _, report = imported([*shapes, (LANE, ROAD)])
    assert len(bays) == report.spots == COUNT
    # As in Wil: an underground car park on a layer of its own below a bus station.
    below = {"amenity": "parking", "parking": "underground", "capacity": "40"}
    shapes = [(rectangle(-20, -20, 40, 30), below | {"layer": "-1"}), (LANE, ROAD)]
    bays, _, report = imported([*shapes, *((bay, SPOT) for bay in BAYS)], level="0")
    assert len(bays) == COUNT
    assert "level -1" in str(report)


def test_a_capacity_that_cannot_be_laid_out_is_told(imported):
    shapes = [(bay, SPOT) for bay in BAYS] + [(LANE, ROAD)]
    shapes += [(rectangle(40, 40, 70, 70), {"amenity": "parking", "capacity": "50"})]
    bays, _, report = imported(shapes)
    assert len(bays) == COUNT
    assert "50" in str(report).split("left out")[1]


def test_spots_as_points_stand_across_the_nearest_road(tmp_path, imported):
    shapes = [([(2.5 * k, 5.5)], SPOT) for k in range(5)] + [([(90, 90)], SPOT)]
    bays, _, report = imported([*shapes, ([(-9, 0), (30, 0)], ROAD)])
    assert len(bays) == 5
    assert np.allclose([box.size for box in bays], (5.0, 2.5), atol=0.03)
    assert len(report.lost) == 1


def test_a_level_is_the_one_with_most_spots_or_the_one_named(imported):
    ground = [(bay, SPOT | {"level": "0"}) for bay in BAYS[:4]]
    upper = [(bay, SPOT | {"level": "1"}) for bay in BAYS]
    shapes = [*ground, *upper, (LANE, ROAD | {"level": "0;1"})]
    bays, _, report = imported(shapes)
    assert len(bays) == COUNT
    assert "0 (4)" in str(report)
    bays, _, _ = imported(shapes, level="0")
    assert len(bays) == 4
    with pytest.raises(ValueError, match="level 7"):
        imported(shapes, level="7")


def read_geojson(tmp_path, data):
    return import_map(write(tmp_path, "a.geojson", json.dumps(data)))


def test_geojson_may_lack_places_and_lanes(tmp_path):
    data = geojson()
    kept = [f for f in data["features"] if f["properties"]["tag"] in ("bay", "wall")]
    nowhere = {"type": "Feature", "properties": None, "geometry": None}
    lot, report = read_geojson(tmp_path, {"features": [*kept[:-1], nowhere]})
    assert report.unknown["feature without a geometry"] == 1
    assert len(lot.bay_mask) == COUNT
    # Starts in both headings, and bays that all head the same way.
    headings = np.exp(1j * np.asarray(lot.spawn_pose)[:, 2])
    assert abs(headings.sum()) < 1e-3
    assert np.allclose(np.diff(np.asarray(lot.bay_pose)[:, 2]), 0, atol=1e-3)


def test_geojson_may_be_one_feature_or_geometry(tmp_path):
    [first, *_] = geojson()["features"]
    lot, _ = read_geojson(tmp_path, first)
    assert np.allclose(lot.bay_size, (LENGTH, WIDTH), atol=0.02)
    with pytest.raises(ValueError, match="no parking spot"):
        read_geojson(tmp_path, first["geometry"])


CLOSED = rectangle(-30, -4, 45, 9)  # around bays and lane, away from its ends
AROUND = {
    "a fence that the road crosses": {"barrier": "fence"},
    "a roof": {"building": "roof"},
    "a building that the road passes through": {"building": "yes"},
}


@pytest.mark.parametrize("name", AROUND)
def test_what_surrounds_spots_leaves_them_in_reach(imported, name):
    shapes = [(bay, SPOT) for bay in BAYS] + [([(-40, 0), (60, 0)], ROAD)]
    bays, starts, report = imported([*shapes, (CLOSED, AROUND[name])])
    assert len(bays) == COUNT
    assert "warning" not in str(report)
    # The road stays whole, so cars drive in from outside.
    assert max(box.length for box in starts) > 90


def test_spots_behind_walls_are_told(tmp_path, capsys):
    pytest.importorskip("ompl")
    shapes = [(bay, SPOT) for bay in BAYS[:2] + BAYS[3:]] + [(LANE, ROAD)]
    cage = [(6.2, 8.2), (6.2, 2.8), (15.2, 2.8), (15.2, 8.2), (6.2, 8.2)]
    shapes += [(cage[:-1], {"barrier": "wall"}), (cage[-2:], {"barrier": "wall"})]
    path = write(tmp_path, "a.osm", osm_xml([(*shape, False) for shape in shapes]))
    out = str(tmp_path / "lot.json")
    assert main(["import", str(path), "--out", out]) == 0
    assert "from 3 of 5 bays" in capsys.readouterr().out
    assert main([out, "--check", "1", "--paths", "9"]) == 1
    assert "3 of 5 bays" in capsys.readouterr().out


def test_polygons_of_autoware_close(imported):
    # A `parking_lot` does not come back to its first node, a `parking_space` is a line.
    area = {"type": "parking_lot", "area": "yes"}
    spot = {"type": "parking_space", "width": WIDTH}
    spots = [
        ([(WIDTH * (k + 0.5), 8), (WIDTH * (k + 0.5), 3)], spot) for k in (0, 1, 2)
    ]
    bays, starts, report = imported([(rectangle(-5, -5, 20, 9)[:-1], area), *spots])
    assert np.allclose([box.size for box in bays], (LENGTH, WIDTH), atol=0.02)
    assert starts
    assert "around its spots" not in str(report)


def test_lanelets_on_foot_are_no_lanes(tmp_path):
    text = lanelet2()
    lane = text[text.index("<relation id='0'>") : text.index("</osm>")]
    foot = lane.replace("id='0'", "id='-5'").replace(
        "<tag k='type'", "<tag k='subtype' v='crosswalk'/><tag k='type'"
    )
    text = text.replace("</osm>", foot + "</osm>")
    lot, report = import_map(write(tmp_path, "a.osm", text))
    assert report.unknown["lanelet crosswalk"] == 1
    assert len(lot.lane_mask) == 1


SHAPES = {
    "L": shapely.box(0, 0, 10, 1).union(shapely.box(0, 0, 1, 8)),
    "ring": shapely.box(0, 0, 10, 8).difference(shapely.box(1, 1, 9, 7)),
    "arc": shapely.Point(0, 0).buffer(10).boundary.buffer(0.5),
    "fine arc": shapely.Point(0, 0).buffer(10, quad_segs=150).boundary.buffer(0.5),
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


def test_a_rectangle_cut_free_keeps_the_most_and_a_row_costs_one_side():
    [box] = boxes(shapely.box(0, 0, 10, 4))
    free = cut_free(box, [shapely.box(-5, 3.5, 20, 9), shapely.box(9, 0, 12, 1)])
    assert free is not None
    assert free.shape.area == pytest.approx(9 * 3.5, rel=0.01)
    assert cut_free(box, [shapely.box(-1, -1, 11, 5)]) is None
    # Corners of six leaning bays that reach into a lane.
    [lane] = boxes(shapely.box(0, 0, 40, 6))
    corners = [shapely.box(x, 5.2, x + 1.0, 7) for x in range(2, 38, 6)]
    free = cut_free(lane, corners)
    assert free is not None
    assert free.size == pytest.approx((40.0, 5.2), abs=0.01)
