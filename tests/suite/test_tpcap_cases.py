"""TPCAP's published cases: the lots are what the files say, and the files theirs."""

import math
import shutil

import jax
import numpy as np
import pytest
import shapely
from helpers.scenes import polygons

from carpark_mj.layouts.checks import find_faults
from carpark_mj.suite import tpcap as layouts
from carpark_mj.suite.tpcap import (
    EDGE,
    FOLDER,
    NUMBERS,
    TPCAP_CAR,
    TpcapConfig,
    load_tpcap,
)

AHEAD = 4.689 / 2 - 0.929  # m, rear axle to the footprint's centre
CASES = 20


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


def test_the_lots_are_valid_for_the_car():
    size = jax.numpy.array(TPCAP_CAR.size)
    faults = jax.jit(jax.vmap(lambda lot: find_faults(lot, size)))(load_tpcap())
    assert {name: int(at.sum()) for name, at in faults.items() if at.any()} == {}


def test_a_key_draws_any_of_them():
    keys = jax.random.split(jax.random.key(0), 200)
    drawn = jax.jit(jax.vmap(TpcapConfig().generate))(keys)
    assert len(np.unique(drawn.bay_pose[:, 0], axis=0)) == CASES
    assert TpcapConfig().is_random
    assert not TpcapConfig(3).is_random
    for wrong in (21, 0):
        with pytest.raises(ValueError, match=f"case must be .* not {wrong}"):
            TpcapConfig(wrong)


def test_a_changed_file_is_refused(tmp_path, monkeypatch):
    shutil.copytree(FOLDER, tmp_path / "data")
    changed = tmp_path / "data" / "case7.csv"
    changed.write_text(changed.read_text().replace("1", "2", 1))
    monkeypatch.setattr(layouts, "FOLDER", tmp_path / "data")
    layouts.published_files.cache_clear()
    with pytest.raises(ValueError, match="other cases than the published ones"):
        layouts.published_files()
    layouts.published_files.cache_clear()
