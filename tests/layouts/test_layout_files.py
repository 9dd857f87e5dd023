"""Layouts from files: JSON, TPCAP cases, real car parks, messages about bad files."""

import contextlib
import dataclasses
import json
import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.mutating import damaged, with_junk
from helpers.programs import layouts as main
from helpers.scenes import polygons
from helpers.trees import assert_close

from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import (
    ROWS,
    FromFileConfig,
    LotConfig,
    layout_config,
    make_layout,
    mixture,
)
from carpark_mj.layouts.car_park import random_parts
from carpark_mj.layouts.checks import ANY_CAR, describe_faults
from carpark_mj.layouts.files import layout_text, read_json
from carpark_mj.layouts.routes import make_routes
from carpark_mj.layouts.types import enlarge
from carpark_mj.suite.tpcap import TPCAP_CAR, read_tpcap
from carpark_mj.wrappers.options import Options, configure, share

HAND = {
    "format": "carpark_mj layout 1",
    "bays": [{"pose": [0, 6, -1.5707963], "size": [5, 2.5], "kind": "accessible"}],
    "walls": [{"pose": [0, 9, 0], "size": [20, 0.4], "kind": "kerb"}],
    "discs": [{"centre": [3, 4.5], "radius": 0.25}],
    "lanes": [{"pose": [0, 0, 0], "size": [20, 6], "one_way": False}],
    "spawns": [{"pose": [-5, 0, 0], "size": [4, 1]}],
    "extent": [10, 10],
}


def written(tmp_path, data):
    path = tmp_path / "hand.json"
    path.write_text(json.dumps(data))
    return path


def test_a_lot_drawn_by_hand_is_read_as_written(tmp_path):
    layout = make_layout(str(written(tmp_path, HAND)))
    np.testing.assert_allclose(layout.bay_pose, [[0, 6, -np.pi / 2]], atol=1e-6)
    assert layout.bay_kind.tolist() == [1]  # accessible
    assert layout.wall_kind.tolist() == [1]  # kerb
    assert layout.disc_kind.tolist() == [0]  # pillar, by default
    assert layout.disc_radius.tolist() == [0.25]
    assert layout.lane_one_way.tolist() == [False]
    np.testing.assert_allclose(layout.spawn_spread, 0.1)
    assert layout.extent.tolist() == [10, 10]


def test_a_file_that_has_changed_is_read_again(tmp_path):
    path = str(written(tmp_path, HAND))
    before, mixed = FromFileConfig(path), mixture([path, "square_compact"])
    options: Options = {"layout": path, "agents": 1, "parked_cars": 0}
    options |= {"physics": "bicycle"}
    env = share(ParkingEnv, configure(options))
    assert before == FromFileConfig(path)
    assert make_layout(path).extent.tolist() == [10, 10]
    written(tmp_path, HAND | {"extent": [12, 10]})
    assert make_layout(path).extent.tolist() == [12, 10]
    assert make_layout(before).extent.tolist() == [10, 10]
    assert before != FromFileConfig(path)
    assert mixed != mixture([path, "square_compact"])
    key, after = jax.random.key(0), share(ParkingEnv, configure(options))
    assert [e.draw_layout(key).extent[0] for e in (env, after)] == [10, 12]


@pytest.mark.parametrize(
    "config", ["square", LotConfig(pillar_every=3, num_aisles=(1, 2))]
)
def test_layouts_are_written_and_read_bit_for_bit(config, tmp_path):
    layout = jax.device_get(make_layout(config, jax.random.key(3)))
    path = tmp_path / "saved.json"
    path.write_text(layout_text(layout))
    back = jax.device_get(read_json(path))
    for name, before in vars(layout).items():
        if before is None:
            continue
        after, kind = getattr(back, name), name.split("_")[0]
        if kind in ROWS:
            before = before[getattr(layout, f"{kind}_mask")]
        if name.endswith("pose"):  # yaw is wrapped again, to 3e-7 rad
            np.testing.assert_allclose(after[:, 2], before[:, 2], atol=1e-6)
            after, before = after[:, :2], before[:, :2]
        np.testing.assert_array_equal(after, before)


def changed(**changes):
    return {**HAND, **changes}


BAD_JSON = [
    (changed(format="carpark_mj layout 2"), "format must be 'carpark_mj layout 1'"),
    ({k: v for k, v in HAND.items() if k != "extent"}, "extent missing"),
    (changed(slots=[]), "unknown list 'slots'"),
    (changed(bays=[*HAND["bays"], {"pose": [0, 0, 0]}]), r"bays\[1\].size is miss"),
    (changed(walls=[{"pose": [0, "x", 0], "size": [1, 1]}]), r"walls\[0\].pose"),
    (changed(discs=[{"centre": [0, 0], "radius": math.nan}]), "must be a number"),
    (changed(walls=[{"pose": [0, 10**400, 0], "size": [1, 1]}]), "at most 10000"),
    (changed(discs=[{"centre": [0, 0], "radius": 1, "r": 2}]), r"discs.0. 'r'"),
    (changed(walls=[{**HAND["walls"][0], "kind": "hedge"}]), "'hedge'; choose"),
    (changed(lanes=[{**HAND["lanes"][0], "one_way": 1}]), "true or false, not 1"),
    (changed(bays=[{"pose": [0, 6, -90], "size": [5, 2]}]), "are in radians"),
    (changed(spawns=[{**HAND["spawns"][0], "spread": 4}]), "spread must lie in"),
    (changed(bays=HAND["bays"] * 2), r"bays overlap: \[\[0, 1\]\]"),
]


def test_a_damaged_file_is_a_layout_or_refused(tmp_path):
    text = written(tmp_path, HAND).read_bytes()
    layout = read_json(tmp_path / "hand.json")
    wrong = dataclasses.replace(layout, spawn_spread=-layout.spawn_spread)
    assert describe_faults(wrong) == ["spawn_spread must not be negative"]
    path = tmp_path / "damaged.json"
    junk = (json.dumps(with_junk(HAND, seed)).encode() for seed in range(100))
    flips = (damaged(text, seed) for seed in range(100))
    for data in (*junk, *flips):
        path.write_bytes(data)
        with contextlib.suppress(ValueError):
            assert describe_faults(read_json(path), ANY_CAR) == []
    path = case(tmp_path, [SQUARE, SHARP])
    text = path.read_bytes()
    for seed in range(100):
        path.write_bytes(damaged(text, seed))
        with contextlib.suppress(ValueError):
            assert describe_faults(read_tpcap(path), TPCAP_CAR.size) == []


def test_a_lot_in_centimetres_is_refused(tmp_path):
    layout = enlarge(read_json(written(tmp_path, HAND)), 100.0)
    path = tmp_path / "large.json"
    path.write_text(layout_text(layout))
    with pytest.raises(ValueError, match=r"bays are not 1 to 30 m"):
        make_layout(str(path))


# TPCAP

SQUARE = [(8, 2), (12, 2), (12, 4), (8, 4)]
LEFT_U = [(-4, 4), (-4, 9), (-3, 9), (-3, 6), (-1, 6), (-1, 9), (0, 9), (0, 4)]
SHARP = [(2, -8), (9, -6), (3, -3)]


def case(tmp_path, polygons_, start=(0, 0, 0), goal=(5, 12, math.pi / 2), text=None):
    numbers = [*start, *goal, len(polygons_), *(len(p) for p in polygons_)]
    numbers += [x for polygon in polygons_ for point in polygon for x in point]
    path = tmp_path / "case.csv"
    path.write_text(text or ",".join(map(str, numbers)) + "\n")
    return path


def test_a_tpcap_case_is_a_bay_a_start_and_walls(tmp_path):
    """Where these lie is tested on the published cases."""
    turned = shapely.affinity.rotate(shapely.Polygon(SQUARE), 33, origin=(0, 0))
    shapes = [list(turned.exterior.coords)[:-1][::-1], LEFT_U, SHARP]
    layout = read_tpcap(case(tmp_path, shapes, goal=(-9, -9, 0)))
    assert describe_faults(layout, TPCAP_CAR.size) == []
    size = [4.689 + 0.4, 1.942 + 0.4]
    np.testing.assert_allclose(layout.bay_size[0], size, atol=1e-5)
    assert layout.spawn_spread.tolist() == [0.0]
    # A rectangle is one wall, another polygon its edges.
    assert len(layout.wall_pose) == 1 + len(LEFT_U) + len(SHARP)


@pytest.mark.parametrize("shift", [(5e3, -2e4), (4.5e9, -8.7e9)])
def test_where_a_case_lies_makes_no_difference(shift, tmp_path):
    def read(dx, dy):
        shapes = [[(x + dx, y + dy) for x, y in shape] for shape in (SQUARE, SHARP)]
        goal = (5 + dx, 12 + dy, 1.0)
        return read_tpcap(case(tmp_path, shapes, start=(dx, dy, 0), goal=goal))

    assert_close(read(*shift), read(0.0, 0.0), atol=1e-5)


def test_a_tight_goal_gets_a_smaller_bay(tmp_path):
    # A wall 0.08 m beside the goal's footprint, which is 1.942 m wide about y = 12.
    wall = [(4, 13.051), (9, 13.051), (9, 14), (4, 14)]
    layout = read_tpcap(case(tmp_path, [wall], goal=(5, 12, 0)))
    more = layout.bay_size[0] - np.array(TPCAP_CAR.size)
    np.testing.assert_allclose(more, 0.1, atol=1e-5)
    assert describe_faults(layout, TPCAP_CAR.size) == []


BAD_CSV = [
    ("1,2,3\n4,5,6\n", r"7 numbers\), not 6"),
    ("1,2,3\n4,5,pi\n", "'pi' is not a number"),
    ("0,0,0,5,12,0\n1.5,3\n", "number of obstacles must be a whole number"),
    ("0,0,0,5,12,0\n3,4\n", "3 obstacles need 3 vertex counts, there are 1"),
    ("0,0,0,5,12,0\n1\n2\n", "vertex count of obstacle 0 .* at least 3, not 2"),
    ("0,0,0,5,12,0,1,3\n1,1,2,2,3\n", "make 14 numbers, not 13"),
    ("0,0,0\n5,12,90\n0\n", "heading must be at most 12.57 rad either way, not 90"),
    ("0,0,0\n5,12,0\n1,4\n5,11,7,11,7,13,5,13\n", "at the goal would stand in an"),
    ("3e9,0,0\n3e9,2e4,0\n0\n", "at most 10000 m from the start's, not 20000 m"),
    ("0,0,0,5,12,0,2,3,4\n9,9,9,8,8,8\n7,7,9,9,9,7,7,9\n", "obstacle 1 has no"),
]


@pytest.mark.parametrize(("content", "message"), BAD_JSON + BAD_CSV)
def test_bad_files_are_told_what_and_where(content, message, tmp_path):
    drawn = isinstance(content, dict)
    path = written(tmp_path, content) if drawn else case(tmp_path, [], text=content)
    with pytest.raises(ValueError, match=message) as caught:
        make_layout(str(path))
    assert str(caught.value).startswith(str(path))
    assert not re.search(r"\n|\\n", str(caught.value))


def test_a_case_without_obstacles_and_a_missing_one(tmp_path):
    layout = make_layout(str(case(tmp_path, [])))
    assert layout.wall_mask.shape == (0,)
    with pytest.raises(ValueError, match=r"cannot read nowhere.csv"):
        make_layout("nowhere.csv")


CAR_PARKS = {"dragon_lake": 364, "san_jose": 232}  # of 364 and of 240 spots
CORNERS = (-30.0, -20.0, 35.0, 33.0)


@pytest.mark.parametrize("name", CAR_PARKS)
def test_bays_open_onto_lanes_and_the_lot_is_valid(name):
    lot = layout_config(name).layout
    assert describe_faults(lot) == []
    assert int(lot.bay_mask.sum()) == CAR_PARKS[name]
    assert (_gaps(lot) < _gaps(lot, -1)).mean() > 0.98
    routes = jax.jit(make_routes)(lot)  # to every bay from every lane
    assert (routes.beside | jnp.isfinite(routes.remaining).any(axis=1)).all()
    # Ten spots of San Jose's map are too short for a car to park strictly in them.
    short = 10 * (name == "san_jose")
    assert layout_config(name).min_goals == CAR_PARKS[name] - short


@pytest.mark.parametrize("name", CAR_PARKS)
def test_a_crop_holds_the_bays_between_its_corners(name):
    config = layout_config(name)
    whole, part = config.layout, config.crop(*CORNERS).layout
    low, high = np.array(CORNERS[:2]), np.array(CORNERS[2:])
    assert np.allclose(part.extent, (high - low) / 2)
    assert describe_faults(part) == []
    region = shapely.box(*CORNERS)
    inside = region.covers(polygons(whole.bay_pose, whole.bay_size))
    # Bays of lanes outside are left out; none has a lane that is farther away.
    before = dict(zip(map(tuple, _places(whole)), _gaps(whole), strict=True))
    drawn = {tuple(place) for place in _places(whole)[inside]}
    moved = _places(part, (low + high) / 2)
    assert {*map(tuple, moved)} <= drawn
    assert 0 < len(moved) < CAR_PARKS[name]
    for place, gap in zip(moved, _gaps(part), strict=True):
        assert gap < before[tuple(place)] + 1.01
    assert len(moved) > 0.5 * len(drawn)
    # A lot may be read for the first time within a traced function.
    config = config.crop(*CORNERS[:3], 32.0)
    lot = jax.jit(config.generate)(jax.random.key(0))
    assert np.array_equal(lot.bay_pose, config.layout.bay_pose)


def _places(lot, shift=(0.0, 0.0)):
    return np.round(lot.bay_pose[:, :2] + np.array(shift), 2)


def _gaps(lot, side=1):
    """Distances of the bays' ends in front (side 1) or behind (-1) to lanes."""
    ahead = np.stack([np.cos(lot.bay_pose[:, 2]), np.sin(lot.bay_pose[:, 2])], axis=-1)
    ends = shapely.points(lot.bay_pose[:, :2] + side * ahead * lot.bay_size[:, :1] / 2)
    lanes = np.array(polygons(lot.lane_pose, lot.lane_size))
    return shapely.distance(ends[:, None], lanes).min(axis=1)


@pytest.mark.parametrize("name", CAR_PARKS)
def test_random_parts_have_bays_enough_and_routes_to_all(name):
    parts = random_parts(name, (60.0, 45.0), 2, seed=1, min_bays=20)
    assert parts == random_parts(name, (60.0, 45.0), 2, seed=1, min_bays=20)
    assert parts[0] != parts[1]
    for part in parts:
        assert np.allclose(part.layout.extent, (30.0, 22.5))
        assert part.min_bays >= 20
        assert describe_faults(part.layout) == []


def test_a_crop_is_saved_as_a_layout_file(tmp_path):
    saved = tmp_path / "corner.json"
    wanted = ["san_jose", "--crop", *map(str, CORNERS), "--save", str(saved)]
    assert main(wanted) == 0
    part = layout_config("san_jose").crop(*CORNERS)
    assert layout_config(str(saved)).min_bays == part.min_bays
