"""Misaligned starts: in the goal bay, free of everything, and not within its lines."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.rules import LIMITS
from helpers.scenes import cars, lot, polygons
from helpers.states import parked_at

from carpark_mj.config import EnvConfig, SpawnConfig
from carpark_mj.mdp.parked_cars import BayFits
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.spawning.goals import place_agent
from carpark_mj.spawning.placing import SpawnInputs, start_placing, surroundings
from carpark_mj.spawning.special_starts import (
    FARTHEST,
    MARGIN,
    misaligned_pose,
    misaligned_shapes,
)
from carpark_mj.spawning.starts import draw_uniform
from carpark_mj.vehicle import COMPACT, make_vehicle

MISALIGNED = SpawnConfig(close_ratio=0.0, misaligned_ratio=1.0)
BAY = (20.0, 0.0, 0.5)
COUNT = 1500


def starts(layout, spawn=MISALIGNED, parked=None):
    """Poses (COUNT, 3) of one car whose goal is bay 0, in a lot that begins."""
    parked = parked_at() if parked is None else parked
    config = EnvConfig(spawn=spawn)
    car = jax.tree.map(lambda x: jnp.asarray(x)[None], make_vehicle(COMPACT))
    inputs = SpawnInputs(layout, parked, None, None, BayFits(), car, first=True)
    placing = start_placing(
        jnp.array([0]), parked.bay, jnp.zeros((1, 3)), jnp.array([True])
    )

    def one(key):
        return place_agent(config, inputs, placing, jnp.array(0), key).pose_w[0]

    return np.asarray(
        jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(3), COUNT))
    )


def in_bay(pose, bay=BAY):
    """Offset along and across, and heading either way round, in the bay's frame."""
    off = (pose[:, 0] - bay[0] + 1j * (pose[:, 1] - bay[1])) * np.exp(-1j * bay[2])
    turned = pose[:, 2] - bay[2]
    return off.real, off.imag, np.arctan(np.tan(turned)), np.cos(turned)


SIZE = (COMPACT.length, COMPACT.width)
# A bay with 0.1 m of room on each side.
TIGHT = lot(
    [BAY, (20.0, 40.0, 0.0)],
    bay_size=(SIZE[0] + 0.2, SIZE[1] + 0.2),
    spawn_size=(1.0, 1.0),
)


def test_they_are_in_the_bay_both_ways_round_and_not_within_its_lines():
    pose = starts(TIGHT)
    along, across, askew, way = in_bay(pose)
    for values, most in zip((along, across, askew), FARTHEST, strict=True):
        assert 0.9 * most < np.abs(values).max() < most + 1e-3
        assert abs(values.mean()) < 0.1 * most
    assert 0.4 < (way > 0).mean() < 0.6
    bay = polygons(np.array([BAY]), np.array([TIGHT.bay_size[0]]))[0]
    assert not shapely.contains(bay, polygons(pose, SIZE)).any()
    bays = (
        np.broadcast_to(BAY, pose.shape),
        np.broadcast_to(TIGHT.bay_size[0], (COUNT, 2)),
    )
    standing = cars(pose, size=SIZE)
    inside = [name for name, limits in LIMITS.items() if limits.inside_lines]
    assert "strict" in inside
    for rule in inside:
        assert not np.asarray(is_parked(rule, standing, *bays)).any()


def test_they_keep_clear_of_what_stands_beside_the_bay():
    width = TIGHT.bay_size[0, 1]
    aside = (
        BAY[0] - np.sin(BAY[2]) * (width / 2 + 0.2),
        np.cos(BAY[2]) * (width / 2 + 0.2),
    )
    walled = lot(
        TIGHT.bay_pose,
        [(*aside, BAY[2])],
        bay_size=TIGHT.bay_size[0],
        wall_size=(8.0, 0.2),
        spawn_size=(1.0, 1.0),
    )
    pose = starts(walled)
    wall = polygons(np.array([[*aside, BAY[2]]]), np.array([[8.0, 0.2]]))[0]
    gaps = shapely.distance(wall, polygons(pose, SIZE))
    assert MARGIN - 1e-3 < gaps.min() < MARGIN + 0.1
    assert in_bay(pose)[1].mean() < -0.02  # farther from the wall


def test_they_overlap_neither_an_agent_nor_a_parked_car():
    beside = [(-np.sin(BAY[2]) * y, np.cos(BAY[2]) * y) for y in (2.2, -2.2)]
    near = np.array([[BAY[0] + x, BAY[1] + y, BAY[2]] for x, y in beside])
    parked = parked_at(near[:1], SIZE)
    both = jax.tree.map(
        lambda x: jnp.stack([jnp.asarray(x)] * 2), make_vehicle(COMPACT)
    )
    sizes = jnp.broadcast_to(jnp.array(SIZE), (2, 2))
    inputs = SpawnInputs(TIGHT, parked, sizes, sizes, BayFits(), both)
    placing = start_placing(
        jnp.array([0, 1]),
        parked.bay,
        jnp.stack([jnp.zeros(3), jnp.asarray(near[1])]),
        jnp.array([True, False]),
    )
    around = surroundings(inputs, placing, jnp.array(0))

    def one(key):
        draws = draw_uniform(misaligned_shapes(MISALIGNED), key)
        return misaligned_pose(inputs, placing, around, jnp.array(0), draws)

    pose, found = jax.vmap(one)(jax.random.split(jax.random.key(4), COUNT))
    assert found.mean() > 0.9
    own = polygons(np.asarray(pose)[np.asarray(found)], SIZE)
    cars_beside = polygons(near, SIZE)
    assert shapely.distance(cars_beside[0], own).min() > MARGIN - 1e-3
    assert 0.0 < shapely.distance(cars_beside[1], own).min() < MARGIN


def test_where_a_car_is_always_within_the_lines_the_start_is_random():
    wide = lot(
        TIGHT.bay_pose, bay_size=(SIZE[0] + 2.0, SIZE[1] + 2.0), spawn_size=(1.0, 1.0)
    )
    assert np.abs(starts(wide)[:, :2]).max() <= 0.5


def test_their_share_is_the_ratio():
    mixed = dataclasses.replace(MISALIGNED, close_ratio=0.1, misaligned_ratio=0.3)
    x = starts(TIGHT, mixed)[:, 0]
    # Deviation 1.2 %: five of them. Others start within 1 m of the origin.
    assert (x > 5.0).mean() == pytest.approx(0.3, abs=0.06)
