"""Real car parks by name, and crops of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.programs import layouts as main
from helpers.scenes import polygons

from carpark_mj.layouts import layout_config
from carpark_mj.layouts.car_park import random_parts
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.routes import make_routes

BAYS = {"dragon_lake": 364, "san_jose": 232}  # of 364 and of 240 spots
CORNERS = (-30.0, -20.0, 35.0, 33.0)


@pytest.mark.parametrize("name", BAYS)
def test_bays_open_onto_lanes_and_the_lot_is_valid(name):
    lot = layout_config(name).layout
    assert describe_faults(lot) == []
    assert int(lot.bay_mask.sum()) == BAYS[name]
    assert (_gaps(lot) < _gaps(lot, -1)).mean() > 0.98


@pytest.mark.parametrize("name", BAYS)
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
    assert 0 < len(moved) < BAYS[name]
    for place, gap in zip(moved, _gaps(part), strict=True):
        assert gap < before[tuple(place)] + 1.01
    assert len(moved) > 0.5 * len(drawn)


def _places(lot, shift=(0.0, 0.0)):
    return np.round(lot.bay_pose[:, :2] + np.array(shift), 2)


def _gaps(lot, side=1):
    """Distances of the bays' ends in front (side 1) or behind (-1) to lanes."""
    ahead = np.stack([np.cos(lot.bay_pose[:, 2]), np.sin(lot.bay_pose[:, 2])], axis=-1)
    ends = shapely.points(lot.bay_pose[:, :2] + side * ahead * lot.bay_size[:, :1] / 2)
    lanes = np.array(polygons(lot.lane_pose, lot.lane_size))
    return shapely.distance(ends[:, None], lanes).min(axis=1)


@pytest.mark.parametrize("name", BAYS)
def test_every_bay_is_reached_from_every_lane(name):
    routes = jax.jit(make_routes)(layout_config(name).layout)
    assert (routes.beside | jnp.isfinite(routes.remaining).any(axis=1)).all()


@pytest.mark.parametrize("name", BAYS)
def test_a_lot_is_first_read_within_a_traced_function(name):
    config = layout_config(name).crop(*CORNERS[:3], 32.0)
    drawn = jax.jit(config.generate)(jax.random.key(0))
    assert np.array_equal(drawn.bay_pose, config.layout.bay_pose)


@pytest.mark.parametrize("name", BAYS)
def test_random_parts_have_bays_enough_and_routes_to_all(name):
    parts = random_parts(name, (60.0, 45.0), 2, seed=1, min_bays=20)
    assert parts == random_parts(name, (60.0, 45.0), 2, seed=1, min_bays=20)
    assert parts[0] != parts[1]
    for part in parts:
        assert np.allclose(part.layout.extent, (30.0, 22.5))
        assert part.min_bays >= 20
        assert describe_faults(part.layout) == []


def test_reserved_bays_are_no_goals():
    """Ten spots of the map are too short for a car to park strictly in them."""
    config = layout_config("san_jose")
    assert config.min_goals == config.min_bays - 10
    assert layout_config("dragon_lake").min_goals == BAYS["dragon_lake"]


def test_a_crop_is_saved_as_a_layout_file(tmp_path):
    saved = tmp_path / "corner.json"
    wanted = ["san_jose", "--crop", *map(str, CORNERS), "--save", str(saved)]
    assert main(wanted) == 0
    part = layout_config("san_jose").crop(*CORNERS)
    assert layout_config(str(saved)).min_bays == part.min_bays
