"""HOPE's levels and TPCAP's cases against what was published, measured by shapely."""

import dataclasses
import itertools
import math
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import polygons

from carpark_mj.config import LAYOUTS
from carpark_mj.layouts.checks import find_faults
from carpark_mj.layouts.registry import TEST, lot_key
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.suite import levels as held_out
from carpark_mj.suite import tpcap
from carpark_mj.suite.hope import HopeConfig
from carpark_mj.suite.levels import CASES, HOPE_LEVELS, load_held_out
from carpark_mj.suite.tpcap import (
    EDGE,
    FOLDER,
    NUMBERS,
    TPCAP_CAR,
    TpcapConfig,
    load_tpcap,
)

LENGTH = TPCAP_CAR.length
# HOPE's `configs.py`: bay beyond the car's width or length, aisle [m].
PUBLISHED = {
    ("normal", False): (0.85, 1.2, 7.0),
    ("complex", False): (0.4, 0.85, 6.0),
    ("normal", True): (0.25 * LENGTH, 0.25 * LENGTH + 0.5, 4.5),
    ("complex", True): (0.9, 0.25 * LENGTH, 4.0),
    ("extreme", True): (0.6, 0.9, 3.5),
}
MM = 3e-3  # m, of distances between boxes in whole millimetres
all_faults = jax.jit(jax.vmap(find_faults, in_axes=(0, None)))


def measure(layout, parallel, size=TPCAP_CAR.size):
    """Gaps left and right of the goal, width of the aisle, room at the start [m]."""
    layout = jax.device_get(layout)
    wall, mask = polygons(layout.wall_pose, layout.wall_size), layout.wall_mask
    goal, start = (
        polygons(pose, size)[0] for pose in (layout.bay_pose, layout.spawn_pose)
    )
    count = 5 if parallel else 6  # a solid obstacle of two boxes, or so many cars
    ends = 1, 1 + count, 1 + 2 * count
    gaps = [
        shapely.distance(goal, wall[low:high][mask[low:high]]).min()
        for low, high in itertools.pairwise(ends)
    ]
    solid = slice(ends[-1]), slice(ends[-1], None)
    near, beyond = (wall[rows][mask[rows]] for rows in solid)
    aisle = shapely.bounds(beyond)[:, 1].min(initial=np.inf)
    aisle = aisle - shapely.bounds(near)[:, 3].max()
    return *gaps, aisle, shapely.distance(start, wall[mask]).min()


@pytest.mark.parametrize("level", HOPE_LEVELS)
def test_every_held_out_case_has_the_published_room(level):
    layouts, parallel = load_held_out(level)
    assert len(parallel) == CASES
    assert parallel.mean() == (1.0 if level == "extreme" else 0.5)
    for index in range(CASES):
        layout = jax.tree.map(lambda x, i=index: x[i], layouts)
        left, right, aisle, room = measure(layout, parallel[index])
        low, high, least = PUBLISHED[level, bool(parallel[index])]
        assert min(left, right) >= 0.1 - MM
        assert low - MM <= left + right <= high + MM
        assert aisle >= least - MM
        assert room > 0


@pytest.mark.parametrize("level", [*HOPE_LEVELS, "tpcap"])
def test_cases_are_valid_lots_for_the_car(level):
    lots = load_tpcap() if level == "tpcap" else load_held_out(level)[0]
    faults = all_faults(lots, jnp.array(TPCAP_CAR.size))
    assert {name: int(at.sum()) for name, at in faults.items() if at.any()} == {}


def test_the_file_is_small_and_a_changed_one_is_refused(tmp_path, monkeypatch):
    data = held_out.FILE.read_bytes()
    assert len(data) < 2e6
    changed = tmp_path / "cases.npz"
    changed.write_bytes(data[:-1] + b"?")
    monkeypatch.setattr(held_out, "FILE", changed)
    load_held_out.cache_clear()
    with pytest.raises(ValueError, match="other cases than the published"):
        load_held_out("normal")
    load_held_out.cache_clear()


@pytest.mark.parametrize("name", [n for n in LAYOUTS if n.startswith("hope")])
def test_levels_are_drawn_for_any_car_and_any_key(name):
    car = DesignCar()  # the compact
    config = dataclasses.replace(LAYOUTS[name], car=car)
    keys = jax.vmap(lot_key)(jnp.arange(64, dtype=jnp.uint32))
    layouts = jax.jit(jax.vmap(config.generate))(keys)
    faults = all_faults(layouts, jnp.array(car.size))
    assert not any(at.any() for at in faults.values())
    room, parallel = config.room, config.orientation == "parallel"
    for index in range(64):
        layout = jax.tree.map(lambda x, i=index: x[i], layouts)
        left, right, aisle, _ = measure(layout, parallel, car.size)
        assert room.excess[0] - 1e-4 <= left + right <= room.excess[1] + 1e-4
        assert aisle >= room.aisle


@pytest.mark.parametrize("level", ["complex", "extreme"])
def test_held_out_cases_are_drawn_from_the_test_split(level):
    number = TEST.start + HOPE_LEVELS.index(level) * CASES + 1
    with jax.enable_x64(True):
        generate = jax.jit(HopeConfig(level, "parallel").generate)
        drawn = jax.device_get(generate(lot_key(np.uint32(number))))
    kept = jax.tree.map(lambda x: np.asarray(x[1]), load_held_out(level)[0])
    for part in ("bay", "wall"):
        one, other = (getattr(lot, f"{part}_mask") for lot in (kept, drawn))
        for name in (f"{part}_pose", f"{part}_size"):
            pair = getattr(kept, name)[one], getattr(drawn, name)[other]
            np.testing.assert_allclose(*pair, atol=MM)
    np.testing.assert_allclose(kept.spawn_pose[0], drawn.spawn_pose[0], atol=MM)
    np.testing.assert_allclose(kept.extent, drawn.extent, atol=MM)


AHEAD = 4.689 / 2 - 0.929  # m, rear axle to the footprint's centre


def published(number):
    """Start, goal and obstacles of a file, centred on its start."""
    text = (FOLDER / f"case{number}.csv").read_text()
    values = [float(cell) for cell in text.split(",") if cell.strip()]
    start, goal, count = np.array(values[:3]), np.array(values[3:6]), int(values[6])
    sizes = [int(value) for value in values[7 : 7 + count]]
    vertices = np.array(values[7 + count :]).reshape(-1, 2) - start[:2]
    shapes = np.split(vertices, np.cumsum(sizes)[:-1])
    goal[:2] -= start[:2]
    return start[2], goal, [shapely.Polygon(shape) for shape in shapes]


@pytest.mark.parametrize("number", NUMBERS)
def test_a_lot_is_its_file(number):
    lot = jax.tree.map(lambda x: x[number - 1], load_tpcap())
    yaw, goal, shapes = published(number)

    def axle(pose):
        return pose[:2] - AHEAD * np.array([math.cos(pose[2]), math.sin(pose[2])])

    start, bay = (pose[0].astype(float) for pose in (lot.spawn_pose, lot.bay_pose))
    np.testing.assert_allclose(axle(bay) - axle(start), goal[:2], atol=2e-5)
    for mine, theirs in ((start[2], yaw), (bay[2], goal[2])):
        assert math.remainder(mine - theirs, 2 * math.pi) == pytest.approx(0, abs=1e-5)
    mask = lot.wall_mask
    walls = polygons(lot.wall_pose[mask], lot.wall_size[mask])
    mine = shapely.transform(shapely.union_all(walls), lambda xy: xy - axle(start))
    theirs = shapely.union_all(shapes)
    assert mine.within(theirs.buffer(1.01 * EDGE, join_style="mitre"))
    outline = theirs.boundary
    outside = mine.difference(theirs.buffer(1e-4)).area  # tips at sharp corners
    assert outside < 0.05 * EDGE * outline.length
    assert outline.difference(mine.buffer(1e-4)).length < 1e-3


def test_a_key_draws_any_of_them():
    keys = jax.random.split(jax.random.key(0), 200)
    drawn = jax.jit(jax.vmap(TpcapConfig().generate))(keys)
    assert len(np.unique(drawn.bay_pose[:, 0], axis=0)) == len(NUMBERS)
    assert TpcapConfig().is_random
    assert not TpcapConfig(3).is_random
    for wrong in (21, 0):
        with pytest.raises(ValueError, match=f"case must be .* not {wrong}"):
            TpcapConfig(wrong)


def test_a_changed_file_is_refused(tmp_path, monkeypatch):
    shutil.copytree(FOLDER, tmp_path / "data")
    changed = tmp_path / "data" / "case7.csv"
    changed.write_text(changed.read_text().replace("1", "2", 1))
    monkeypatch.setattr(tpcap, "FOLDER", tmp_path / "data")
    tpcap.published_files.cache_clear()
    with pytest.raises(ValueError, match="other cases than the published ones"):
        tpcap.published_files()
    tpcap.published_files.cache_clear()
