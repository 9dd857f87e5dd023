"""Lots of training and lots held out: two halves of one numbering that never meet."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import StreetConfig, make_layout, mixture
from carpark_mj.layouts.registry import TEST, TRAIN, lot_key, lot_number

DRAWS = 100_000
STREET = StreetConfig(bays_per_side=(3, 4))


@functools.cache
def numbers(split, seed=0):
    keys = jax.random.split(jax.random.key(seed), DRAWS)
    draw = jax.jit(jax.vmap(functools.partial(lot_number, split)))
    return np.asarray(draw(keys)).astype(np.int64)


def test_the_ranges_of_the_splits_divide_all_numbers():
    assert TRAIN.start == 0
    assert TRAIN.stop == TEST.start
    assert TEST.stop == 2**32


@pytest.mark.parametrize(("split", "span"), [("train", TRAIN), ("test", TEST)])
def test_a_split_draws_from_all_of_its_range_and_from_nothing_else(split, span):
    drawn = numbers(split)
    assert drawn.min() >= span.start
    assert drawn.max() < span.stop
    # Uniform: the mean of so many is off by 5 of its standard deviations at most.
    share = (drawn - span.start) / len(span)
    assert abs(share.mean() - 0.5) < 5 / np.sqrt(12 * DRAWS)
    assert share.min() < 1e-3
    assert share.max() > 1 - 1e-3


def test_no_two_numbers_share_a_key():
    """Also across splits, for neighbours and for numbers that differ in one bit."""
    ends = np.r_[0:1000, TEST.start - 1000 : TEST.start + 1000, 2**32 - 1000 : 2**32]
    powers = 2 ** np.arange(32)
    every = np.r_[numbers("train"), numbers("test"), ends, powers, powers ^ TEST.start]
    every = np.unique(every).astype(np.uint32)
    keys = jax.random.key_data(jax.jit(jax.vmap(lot_key))(jnp.asarray(every)))
    assert len(np.unique(keys, axis=0)) == len(every)


def test_the_same_number_is_the_same_lot_under_any_default_generator():
    before = jax.random.key_data(lot_key(5))
    with jax.default_prng_impl("rbg"):
        np.testing.assert_array_equal(jax.random.key_data(lot_key(5)), before)


def test_an_environment_s_lots_are_those_of_the_split_asked_for(monkeypatch):
    config = EnvConfig(layout=STREET, num_agents=1, num_parked_cars=0)
    env, key = ParkingEnv(config, SlidePhysics()), jax.random.key(3)
    layout_key = jax.random.split(key)[1]
    # What `reset` would start in: what follows is the same for every layout.
    monkeypatch.setattr(env, "reset_to_layout", lambda layout, key, *_: (layout, key))
    reset = jax.jit(env.reset, static_argnums=1)
    started = {"": env.reset(key)[0]}
    for split, span in (("train", TRAIN), ("test", TEST)):
        started[split] = reset(key, split)[0]
        number = int(lot_number(split, layout_key))
        assert number in span
        lot = make_layout(STREET, lot_key(number))
        for mine, drawn in zip(
            *map(jax.tree.leaves, (started[split], lot)), strict=True
        ):
            np.testing.assert_allclose(mine, drawn, atol=2e-5)  # float32 at 20 m
    np.testing.assert_allclose(
        started[""].bay_pose, started["train"].bay_pose, atol=2e-5
    )


def test_a_lot_that_no_key_changes_starts_as_if_there_were_no_splits(monkeypatch):
    env = ParkingEnv(EnvConfig(layout="square_compact", num_agents=1), SlidePhysics())
    key = jax.random.key(8)
    monkeypatch.setattr(env, "reset_to_layout", lambda layout, key, *_: (layout, key))
    for split in ("train", "test"):
        layout, used = env.reset(key, split)
        assert used is key  # unsplit: the draws that follow are those of before
        np.testing.assert_array_equal(
            layout.bay_pose, make_layout("square_compact").bay_pose
        )


def test_a_member_of_a_mixture_can_be_asked_for():
    config = EnvConfig(
        layout=mixture(["square_compact", STREET]), num_agents=1, num_parked_cars=0
    )
    env = ParkingEnv(config, SlidePhysics())
    draw = jax.jit(jax.vmap(lambda key, k: env.draw_layout(key, "test", k)))
    keys = jax.random.split(jax.random.key(0), 8)
    lanes = draw(keys, jnp.arange(8) % 2).lane_mask.sum(axis=-1)
    assert lanes.tolist() == [0, 2] * 4  # only streets have lanes
