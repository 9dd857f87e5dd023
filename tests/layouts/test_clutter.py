"""Bays among pieces of outlines: what is free, what is drawn, mixtures with them."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.programs import layouts as main
from helpers.scenes import polygons
from helpers.sliding import SlidePhysics

from carpark_mj.config import LAYOUTS, EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import box_inside
from carpark_mj.layouts import BayEnd, ClutterConfig, DesignCar, StreetConfig, mixture
from carpark_mj.layouts.checks import find_faults
from carpark_mj.layouts.clutter import MARGINS, STARTS
from carpark_mj.types import NO_BAY

NAMES = [name for name in LAYOUTS if name.startswith("clutter")]
KEYS = 400


@functools.cache
def drawn(name):
    """Lots as numpy arrays with a leading (keys,), and by faults how many have them."""
    config = LAYOUTS[name]

    def make(key):
        layout = config.generate(key)
        faults = find_faults(layout, jnp.array(config.car.size))
        return layout, {text: fault.any() for text, fault in faults.items()}

    keys = jax.random.split(jax.random.key(0), KEYS)
    batch, faults = jax.device_get(jax.jit(jax.vmap(make))(keys))
    return batch, {text: found.sum() for text, found in faults.items() if found.any()}


@pytest.mark.parametrize("name", NAMES)
def test_bays_and_starts_are_free_in_every_lot(name):
    batch, faults = drawn(name)
    assert faults == {}
    assert batch.bay_mask.all()
    assert batch.spawn_mask[:, 0].all()  # the first start is always there
    assert batch.spawn_mask.mean() > 0.5
    assert 0 < batch.wall_mask.mean() < 0.8


@pytest.mark.parametrize("name", ["clutter", "clutter_roomy", "clutter_tight"])
def test_bays_are_larger_than_the_car_by_the_room_beside_it(name):
    config, (batch, _) = LAYOUTS[name], drawn(name)
    more = batch.bay_size[:, 0] - config.car.size
    np.testing.assert_allclose(more[:, 0], more[:, 1], atol=1e-5)
    shares = (np.abs(more[:, :1] - 2 * np.array(MARGINS)) < 1e-4).mean(axis=0)
    assert shares.sum() == pytest.approx(1.0)
    if config.gap[0] > 0.5:  # nothing but discs and boxes may be near
        assert shares[-1] > 0.95
    else:
        assert shares.min() > 0.02


def test_tighter_lots_have_less_room_and_more_walls():
    batches = [drawn(f"clutter{name}")[0] for name in ("_roomy", "", "_tight")]
    walls = [batch.wall_mask.mean() for batch in batches]
    sizes = [batch.bay_size[..., 1].mean() for batch in batches]
    assert walls == sorted(walls)
    assert sizes == sorted(sizes, reverse=True)


def test_ends_and_orientations_are_drawn_in_their_shares():
    batch, _ = drawn("clutter")
    shares = np.bincount(batch.bay_end[:, 0], minlength=3) / KEYS
    # Five standard deviations of 400 draws.
    np.testing.assert_allclose(shares, [0.4, 0.2, 0.4], atol=0.125)
    assert batch.bay_end.dtype == np.int32
    across = np.abs(np.sin(batch.bay_pose[:, 0, 2])) > 0.5
    assert across.mean() == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize("name", ["clutter", "clutter_tight"])
def test_most_starts_lead_to_the_bay(name):
    """A disc of the car's width can roll from there to the middle of the bay."""
    batch, _ = drawn(name)
    reached = []
    for k in range(40):
        lot = jax.tree.map(lambda x, k=k: x[k], batch)
        walls = polygons(lot.wall_pose[lot.wall_mask], lot.wall_size[lot.wall_mask])
        centres = shapely.points(lot.disc_centre[lot.disc_mask])
        discs = shapely.buffer(centres, lot.disc_radius[lot.disc_mask])
        x, y = lot.extent
        solid = shapely.union_all([*walls, *discs])
        room = shapely.box(-x, -y, x, y).difference(solid)
        parts = shapely.get_parts(room.buffer(-DesignCar().width / 2))
        goal = shapely.points(lot.bay_pose[0, :2])
        [part] = [p for p in parts if p.intersects(goal)]
        starts = shapely.points(lot.spawn_pose[lot.spawn_mask, :2])
        assert part.intersects(starts[0])  # nothing stands on the way to this one
        reached += part.intersects(starts).tolist()
    assert np.mean(reached) > 0.9


def test_starts_are_before_the_bay_and_elsewhere():
    batch, _ = drawn("clutter")
    away = batch.spawn_pose[..., :2] - batch.bay_pose[..., :2]
    away = np.linalg.norm(away, axis=-1)[batch.spawn_mask]
    assert np.quantile(away, 0.05) < 4.5
    assert 4.5 < np.median(away) < 8.5
    assert np.quantile(away, 0.99) > 10.0
    assert batch.spawn_mask.shape[1] == STARTS
    bounds = jnp.zeros(3), 2 * batch.extent[:, None]
    assert box_inside(batch.spawn_pose, batch.spawn_size, *bounds).all()


def test_a_mixture_draws_the_same_lots_with_more_rows():
    member, other = ClutterConfig(), StreetConfig()
    both, key = mixture([member, other]), jax.random.key(5)
    own, padded = jax.jit(
        lambda key: (member.generate(key), both.generate_member(jnp.int32(0), key))
    )(key)
    for a, b in zip(*map(jax.tree.leaves, (own, padded)), strict=True):
        np.testing.assert_allclose(a, b[: len(a)], atol=2e-5)
        assert not a.weak_type
        assert not np.any(b[len(a) :])


def test_in_mixtures_these_lots_have_one_agent_others_several():
    config = EnvConfig(
        layout=mixture([ClutterConfig(), StreetConfig()]),
        num_agents=4,
        min_agents=1,
        num_parked_cars=6,
        occupancy=(0.2, 0.8),
    )
    env = ParkingEnv(config, SlidePhysics())
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 64))
    alone = np.asarray(state.layout.bay_mask).sum(axis=1) == 1
    counts = np.asarray(state.present).sum(axis=1)
    assert 10 < alone.sum() < 54
    assert (counts[alone] == 1).all()
    assert (counts[~alone] > 1).any()
    parked = np.asarray(state.parked_cars.bay) != NO_BAY
    assert not parked[alone].any()
    assert parked[~alone].any()
    ends = np.asarray(state.layout.bay_end)
    assert (ends[~alone] == BayEnd.EITHER).all()


def test_lots_are_drawn_for_cars_between_two_sizes_and_without_density_are_open():
    config = dataclasses.replace(LAYOUTS["clutter_sizes"], density=(0.0, 0.0))
    make = jax.jit(jax.vmap(config.generate))
    batch = make(jax.random.split(jax.random.key(1), 200))
    assert not batch.wall_mask.any()
    assert not batch.disc_mask.any()
    np.testing.assert_array_equal(batch.wall_size, 0.0)
    car = np.asarray(batch.bay_size[:, 0]) - 2 * MARGINS[-1]
    small, large = np.array(config.car.size), np.array(config.largest.size)
    share = (car - small) / (large - small)
    np.testing.assert_allclose(share[:, 0], share[:, 1], atol=1e-4)
    assert share.min() < 0.05
    assert share.max() > 0.95
    with pytest.raises(ValueError, match="must be at most 1"):
        ClutterConfig(nose_first=0.7, tail_first=0.4)


def test_the_command_says_in_what_share_of_lots_there_is_a_path(capsys):
    pytest.importorskip("ompl")
    main(["clutter_roomy", "--check", "3", "--paths", "1"])
    found = capsys.readouterr().out
    assert "clutter_roomy: 3 lots, 0 with bays out of reach; 100.0 % (43.9" in found
