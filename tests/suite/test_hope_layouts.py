"""HOPE's levels against the published numbers, measured by shapely."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.drawn_cases import draw_hope
from helpers.scenes import polygons

from carpark_mj.config import LAYOUTS
from carpark_mj.layouts.checks import find_faults
from carpark_mj.layouts.registry import TEST, lot_key
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.suite import levels as held_out
from carpark_mj.suite.hope import HopeConfig
from carpark_mj.suite.levels import CASES, HOPE_LEVELS, load_held_out
from carpark_mj.suite.tpcap import TPCAP_CAR

LENGTH, WIDTH = TPCAP_CAR.size
# HOPE's `configs.py`: bay beyond the car's width or length, aisle [m].
PUBLISHED = {
    ("normal", False): (0.85, 1.2, 7.0),
    ("complex", False): (0.4, 0.85, 6.0),
    ("normal", True): (0.25 * LENGTH, 0.25 * LENGTH + 0.5, 4.5),
    ("complex", True): (0.9, 0.25 * LENGTH, 4.0),
    ("extreme", True): (0.6, 0.9, 3.5),
}
MM = 3e-3  # m, of distances between boxes in whole millimetres
SIZE = jnp.array(TPCAP_CAR.size)
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
    near, beyond = (
        wall[: ends[-1]][mask[: ends[-1]]],
        wall[ends[-1] :][mask[ends[-1] :]],
    )
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


@pytest.mark.parametrize("level", HOPE_LEVELS)
def test_held_out_cases_are_valid_lots_for_the_car(level):
    faults = all_faults(load_held_out(level)[0], SIZE)
    assert {name: int(at.sum()) for name, at in faults.items() if at.any()} == {}


def test_the_stored_cases_are_those_drawn():
    level = "extreme"
    first = draw_hope(level, 3)
    with np.load(held_out.FILE) as file:
        for name, array in first.items():
            kept = file[f"{level}_{name}"]
            assert kept.dtype == array.dtype
            # Rows of obstacles are padded to the most of the level.
            np.testing.assert_array_equal(array, kept[:3])


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


def test_held_out_cases_come_from_the_test_split():
    config = HopeConfig("complex", "parallel")
    with jax.enable_x64(True):
        key = lot_key(np.uint32(TEST.start + 1001))
        drawn = jax.device_get(jax.jit(config.generate)(key))
    kept = load_held_out("complex")[0].bay_pose[1]
    np.testing.assert_allclose(kept, drawn.bay_pose, atol=1e-3)


def test_a_parallel_goal_faces_the_way_the_car_starts():
    for level in HOPE_LEVELS:
        layouts, parallel = load_held_out(level)
        yaw = np.asarray(layouts.spawn_pose[:, 0, 2] - layouts.bay_pose[:, 0, 2])
        # Headings are up to 90 deg off the aisle, parked cars up to 15 deg.
        assert (np.cos(yaw[parallel]) > np.cos(np.radians(105.0))).all()
