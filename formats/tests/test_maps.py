"""Maps become layouts: a known lot comes back from every format, faults are refused."""

import json
import math

import numpy as np
import pytest
import shapely
from helpers.mutating import damaged, with_junk
from helpers.programs import assert_refused
from helpers.programs import layouts as main
from map_texts import (
    BAYS,
    COUNT,
    LANE_WIDTH,
    LENGTH,
    TEXTS,
    TURN,
    WIDTH,
    commonroad,
    dxf,
    geojson,
    openstreetmap,
    rectangle,
    write,
)

from carpark_formats.maps import importing as assembling
from carpark_formats.maps.importing import import_map
from carpark_mj.layouts.files import read_json
from carpark_mj.layouts.types import BayKind


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
    centres = np.concatenate([lot.bay_pose, lot.wall_pose, lot.lane_pose])[:, :2]
    bays = [(WIDTH * (k + 0.5), 5.5) for k in range(COUNT)]
    drawn = np.array([*bays, (7.5, 8.4), (7.5, 0.0)])
    apart, expected = (
        np.linalg.norm(xy[:, None] - xy, axis=-1) for xy in (centres, drawn)
    )
    assert np.allclose(apart, expected, atol=0.05)
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
    one, _ = import_map(write(tmp_path, "one.geojson", json.dumps(geojson())))
    path = write(tmp_path, "two.geojson", json.dumps(data))
    with pytest.raises(ValueError, match="--crs"):
        import_map(path)
    by_flag, _ = import_map(path, crs="EPSG:25832")
    data["crs"] = {"properties": {"name": "EPSG:25832"}}
    other, _ = import_map(write(tmp_path, "two.geojson", json.dumps(data)))
    for lot in (by_flag, other):
        assert np.allclose(one.bay_size, lot.bay_size, atol=1e-3)
        # Its grid's north is another one, and the lot is turned to its rows.
        assert np.allclose(one.bay_pose, lot.bay_pose, atol=1e-2)


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
    x, y = disc - lane[:2]
    across = y * np.cos(lane[2]) - x * np.sin(lane[2])
    assert abs(across) == pytest.approx(3.3, abs=0.01)


def test_obstacles_of_the_surroundings_stand_where_their_shapes_are(tmp_path):
    x, y = 3000.0 + 3.3 * math.sin(TURN), -500.0 - 3.3 * math.cos(TURN)
    pillar = (
        "<environmentObstacle id='7'><type>pillar</type><shape><circle><radius>0.3"
        f"</radius><center><x>{x}</x><y>{y}</y></center></circle></shape>"
        "</environmentObstacle></commonRoad>"
    )
    text = commonroad().replace("</commonRoad>", pillar)
    lot, report = import_map(write(tmp_path, "commonroad.xml", text))
    [lane], [disc] = np.asarray(lot.lane_pose), np.asarray(lot.disc_centre)
    local = (disc - lane[:2]) @ [1, 1j] * np.exp(-1j * lane[2])
    assert abs(local.imag) == pytest.approx(3.3, abs=0.01)
    # The report says where the map's frame is in the lot.
    there = complex(x, y) * np.exp(1j * report.turned) + report.shift
    assert abs(there - disc @ [1, 1j]) < 0.01


FAR_SPOT, SMALL_SPOT = rectangle(2500, 0, 2505, 2), rectangle(0, 3, 2, 5)
ONE = '{"features": [{"geometry": %s}]}'
LOST = geojson() | {"crs": {"properties": {"name": "EPSG:0"}}}
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
    "a far scenario": ("a.xml", commonroad([*BAYS, FAR_SPOT]), "at most 2 km"),
    "no spot": ("a.osm", openstreetmap([]), "no parking spot"),
    "too many spots": ("a.osm", openstreetmap(BAYS * 84), "504 spots; at most 500"),
    "too large": ("a.osm", openstreetmap([*BAYS, FAR_SPOT]), "at most 2 km"),
    "small spots": ("a.osm", openstreetmap([SMALL_SPOT]), "smaller than the car"),
    "no collection": ("a.geojson", "{}", "features"),
    "no geometry": ("a.geojson", ONE % '{"type": "Line"}', "features[0] must have a"),
    "no geometry at all": ("a.geojson", ONE % "null", "no feature with a geometry"),
    "unknown system": ("a.geojson", json.dumps(LOST), "EPSG:0"),
    "no DXF": ("a.dxf", "0\nSECTION\n", "no DXF"),
    "no unit": ("a.dxf", dxf(units=0), "$INSUNITS"),
    "another format": ("a.svg", "", ".geojson"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_what_is_no_map_is_refused_in_one_sentence(tmp_path, capsys, fault):
    name, text, told = BROKEN[fault]
    path, out = write(tmp_path, name, text), tmp_path / "lot.json"
    words = ["import", str(path), "--out", str(out)]
    assert str(path) in assert_refused(capsys, "layouts", words, told)
    assert not out.exists()


@pytest.mark.parametrize("name", TEXTS)
def test_damaged_maps_are_imported_or_refused(tmp_path, monkeypatch, name):
    # A lot of every size would be compiled on its own.
    monkeypatch.setattr(assembling, "_layout", lambda *parts: (parts, (0.0, 0.0)))
    monkeypatch.setattr(assembling, "describe_faults", lambda layout: [])
    path, told = tmp_path / name, []
    for seed in range(100):
        if name.endswith(".geojson") and seed % 2:
            data = json.dumps(with_junk(geojson(), seed)).encode()
        else:
            data = damaged(TEXTS[name]().encode(), seed)
        path.write_bytes(data)
        try:
            _, report = import_map(path)
        except ValueError as error:
            told.append(str(error))
        else:
            assert len(report.errors) + len(report.lost) == report.spots
    assert 0 < len(told) < 100
    assert all(x.startswith(f"{path}: ") and "\n" not in x for x in told)


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
