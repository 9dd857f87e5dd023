"""Starts of exploring agents, rule by rule: close to a free bay, or in conflict."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.spawning.exploring import (
    ExploringStart,
    exploring_start,
    first_goal,
    first_goals,
)

HALF = 21 * WORLD_UNIT
LAYOUT = pad_layout(make_layout("tanner"), Maxima(40, 8, 0, 0, 1))
BAYS = 40  # four of them padding
CLOSE = SpawnConfig(close_ratio=1.0)
MIXED = SpawnConfig(close_ratio=0.3, crash_ratio=0.2)
# Agent 0 starts; 1 heads for bay 3, 2 explores.
GOAL = jnp.array([5, 3, BAYS], jnp.int32)
PARKED = jnp.array([0, 1, 2, 10, BAYS], jnp.int32)
XY = jnp.array([[0.0, 0.0], [-9.0, -9.0], [9.0, 9.0]])
OTHERS = jnp.array([False, True, True])


@functools.partial(jax.jit, static_argnums=0)
def draw(config, parked, xy, keys, wall=-jnp.inf):
    def one(key):
        def blocked(pose):
            return pose[:, 0] < wall

        return exploring_start(config, LAYOUT, GOAL, parked, xy, OTHERS, key, blocked)

    return jax.vmap(one)(keys)


def starts(config, parked=PARKED, xy=XY, count=2000, **rest):
    keys = jax.random.split(jax.random.key(0), count)
    return jax.device_get(draw(config, parked, xy, keys, **rest))


def test_a_close_start_is_near_a_free_bay_that_is_nobody_s_goal():
    start = starts(CLOSE)
    drawn = np.unique(start.close_bay)
    # Parked cars, agent 1's goal and padding are out; agent 0's old goal is not.
    assert not set(drawn) & {0, 1, 2, 3, 10, 36, 37, 38, 39, 40}
    assert 5 in drawn
    assert len(drawn) > 20  # those near another agent come seldom
    goal = np.asarray(LAYOUT.bay_pose)[start.close_bay, :2]
    nearest = np.clip(goal, -HALF, HALF)
    gap = np.linalg.norm(start.pose[:, :2] - nearest, axis=1)
    assert gap.max() <= CLOSE.close_distance + 1e-4
    assert not start.crash.any()


def test_a_close_start_keeps_its_distance_and_touches_nothing():
    start = starts(CLOSE)
    gap = np.linalg.norm(start.pose[:, None, :2] - np.asarray(XY[1:]), axis=-1)
    assert gap.min() > CLOSE.min_distance
    start = starts(CLOSE, wall=jnp.float32(0.0))
    assert start.pose[:, 0].min() >= 0.0


def test_without_a_free_bay_to_start_near_the_start_is_random():
    every = jnp.arange(36, dtype=jnp.int32)
    start = starts(CLOSE, parked=every)
    assert (start.close_bay == BAYS).all()
    random = starts(dataclasses.replace(CLOSE, close_ratio=0.0), parked=every)
    np.testing.assert_array_equal(start.pose, random.pose)


def test_exploring_starts_come_in_their_ratios():
    start = starts(MIXED, count=4000)
    # Deviation 0.7 %: five of them.
    assert (start.close_bay < BAYS).mean() == pytest.approx(0.3, abs=0.036)
    assert start.crash.mean() == pytest.approx(0.2, abs=0.032)
    assert not (start.crash & (start.close_bay < BAYS)).any()


SPACES = jnp.array([7, 3, BAYS, 8], jnp.int32)


def goals(close_bay=BAYS, crash=False, others=(3, 8, BAYS, BAYS), count=2000):
    """First goals of an agent that tracks bays 7, 3 and 8, and how often each came."""
    start = ExploringStart(
        jnp.zeros(3), jnp.asarray(close_bay, jnp.int32), jnp.asarray(crash)
    )
    others = jnp.array(others, jnp.int32)
    keys = jax.random.split(jax.random.key(1), count)
    drawn = jax.vmap(lambda key: first_goal(start, SPACES, others, BAYS, key))(keys)
    assert drawn.dtype == jnp.int32
    values, counts = np.unique(np.asarray(drawn), return_counts=True)
    return dict(zip(values.tolist(), (counts / count).tolist(), strict=True))


def test_a_random_start_begins_exploring():
    assert goals() == {BAYS: 1.0}


def test_half_of_the_close_starts_have_the_bay_for_their_goal_if_they_track_it():
    share = goals(close_bay=7)
    # Deviation 1.1 %: five of them.
    assert share == pytest.approx({7: 0.5, BAYS: 0.5}, abs=0.056)
    assert goals(close_bay=9) == {BAYS: 1.0}


def test_a_crash_start_takes_a_random_tracked_bay_that_is_another_s_goal():
    assert goals(crash=True) == pytest.approx({3: 0.5, 8: 0.5}, abs=0.056)
    assert goals(crash=True, others=(8, 9, 8)) == {8: 1.0}
    # Nobody heads for a tracked bay; who explores has no goal to share.
    assert goals(crash=True, others=(9, BAYS)) == {BAYS: 1.0}


def test_first_goals_are_those_of_the_agents_that_start():
    starts = ExploringStart(
        pose=jnp.zeros((4, 3)),
        close_bay=jnp.full(4, BAYS, jnp.int32),
        crash=jnp.array([True, True, False, True]),
    )
    spaces = jnp.tile(SPACES, (4, 1))
    goal = jnp.array([BAYS, 8, BAYS, BAYS], jnp.int32)
    fresh = jnp.array([True, False, True, False])
    got = first_goals(starts, spaces, goal, fresh, BAYS, jax.random.key(0))
    # 0 joins agent 1, who drives on; 2 is no crash start, 3 does not start.
    np.testing.assert_array_equal(got, [8, 8, BAYS, BAYS])
