"""Starts of exploring agents, rule by rule: close to a free bay, or in conflict."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.spawning import walled
from helpers.states import parked_in

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import Maxima, make_layout, pad_layout
from carpark_mj.mdp.parked_cars import BayFits
from carpark_mj.spawning.goals import first_goals, place_exploring
from carpark_mj.spawning.placing import SpawnInputs, start_placing
from carpark_mj.types import NO_BAY

HALF = 21 * WORLD_UNIT
LAYOUT = pad_layout(make_layout("square"), Maxima(40, 8, 0, 0, 1))
BAYS = 40  # four of them padding
CLOSE = SpawnConfig(close_ratio=1.0)
MIXED = SpawnConfig(close_ratio=0.3, conflict_ratio=0.2)
# Agent 0 starts; 1 heads for bay 3, 2 explores.
GOAL = jnp.array([NO_BAY, 3, NO_BAY], jnp.int32)
PARKED = (0, 1, 2, 10, NO_BAY)
POSE = jnp.array([[0.0, 0.0, 0.0], [-9.0, -9.0, 0.0], [9.0, 9.0, 0.0]])


@functools.partial(jax.jit, static_argnums=0)
def draw(config, inputs, placing, keys):
    def one(key):
        drawn = place_exploring(config, inputs, placing, jnp.array(0), key)
        others = (drawn.goal[1:], drawn.pose_w[1:], drawn.close_bay[1:])
        return drawn.pose_w[0], drawn.close_bay[0], drawn.conflict, others

    return jax.vmap(one)(keys)


def starts(config, parked=PARKED, layout=LAYOUT, size=None, count=2000):
    """Poses of agent 0, bays next to which they are, whether it is in conflict."""
    cars = parked_in(layout, parked)
    sizes = None if size is None else jnp.broadcast_to(jnp.asarray(size), (3, 2))
    inputs = SpawnInputs(layout, cars, sizes, sizes, BayFits())
    placing = start_placing(GOAL, cars.bay, POSE, jnp.arange(3) == 0)
    keys = jax.random.split(jax.random.key(0), count)
    drawn = jax.device_get(draw(config, inputs, placing, keys))
    pose, close_bay, conflict, (goal, others, others_bay) = drawn
    # Nobody else is touched.
    np.testing.assert_array_equal(goal, np.tile(GOAL[1:], (count, 1)))
    np.testing.assert_array_equal(others, np.tile(POSE[1:], (count, 1, 1)))
    assert (others_bay == NO_BAY).all()
    assert not conflict[:, 1:].any()
    return pose, close_bay, conflict[:, 0]


def test_a_close_start_is_near_a_free_bay_that_is_nobody_s_goal():
    pose, close_bay, conflict = starts(CLOSE)
    drawn = np.unique(close_bay)
    # Parked cars, agent 1's goal and padding are out.
    assert not set(drawn) & {0, 1, 2, 3, 10, 36, 37, 38, 39, NO_BAY}
    assert 5 in drawn
    assert len(drawn) > 20  # those near another agent come seldom
    goal = np.asarray(LAYOUT.bay_pose)[close_bay, :2]
    nearest = np.clip(goal, -HALF, HALF)
    gap = np.linalg.norm(pose[:, :2] - nearest, axis=1)
    assert gap.max() <= CLOSE.close_distance + 1e-4
    assert not conflict.any()


def test_a_close_start_keeps_its_distance_and_touches_nothing():
    pose, _, _ = starts(CLOSE)
    gap = np.linalg.norm(pose[:, None, :2] - np.asarray(POSE[1:, :2]), axis=-1)
    assert gap.min() > CLOSE.min_distance
    assert pose[:, 0].min() < 0.0
    # A wall fills the left half: of a car of 4 m by 2 m no corner is there.
    layout = walled(LAYOUT, (-10.0, 0.0, 0.0), (20.0, 60.0))
    pose, close_bay, _ = starts(CLOSE, layout=layout, size=(4.0, 2.0))
    assert (close_bay != NO_BAY).all()
    x, _, yaw = pose.T
    assert (x - 2.0 * np.abs(np.cos(yaw)) - np.abs(np.sin(yaw))).min() > -1e-5


def test_without_a_free_bay_to_start_near_the_start_is_random():
    every = tuple(range(36))
    pose, close_bay, _ = starts(CLOSE, parked=every)
    assert (close_bay == NO_BAY).all()
    random = dataclasses.replace(CLOSE, close_ratio=0.0)
    np.testing.assert_allclose(pose, starts(random, parked=every)[0], atol=1e-5)


def test_exploring_starts_come_in_their_ratios():
    _, close_bay, conflict = starts(MIXED, count=4000)
    close = close_bay != NO_BAY
    # Deviation 0.7 %: five of them.
    assert close.mean() == pytest.approx(0.3, abs=0.036)
    assert conflict.mean() == pytest.approx(0.2, abs=0.032)
    assert not (conflict & close).any()


TRACKED = jnp.array([7, 3, NO_BAY, 8], jnp.int32)


def goals(close_bay=NO_BAY, conflict=False, others=(3, 8, NO_BAY, NO_BAY), count=2000):
    """First goals of an agent that tracks bays 7, 3 and 8, and how often each came."""
    goal = jnp.array([NO_BAY, *others], jnp.int32)
    num_agents = goal.shape[0]
    begun = jnp.arange(num_agents) == 0
    placing = start_placing(goal, goal, jnp.zeros((num_agents, 3)), begun)
    placing = placing.replace(
        close_bay=placing.close_bay.at[0].set(close_bay),
        conflict=placing.conflict.at[0].set(conflict),
    )
    tracked = jnp.tile(TRACKED, (num_agents, 1))
    keys = jax.random.split(jax.random.key(1), count)
    drawn = jax.vmap(lambda key: first_goals(placing, tracked, goal, begun, key))(keys)
    assert drawn.dtype == jnp.int32
    assert (drawn[:, 1:] == goal[1:]).all()
    values, counts = np.unique(np.asarray(drawn[:, 0]), return_counts=True)
    return dict(zip(values.tolist(), (counts / count).tolist(), strict=True))


def test_a_random_start_begins_exploring():
    assert goals() == {NO_BAY: 1.0}


def test_half_of_the_close_starts_have_the_bay_for_their_goal_if_they_track_it():
    share = goals(close_bay=7)
    # Deviation 1.1 %: five of them.
    assert share == pytest.approx({7: 0.5, NO_BAY: 0.5}, abs=0.056)
    assert goals(close_bay=9) == {NO_BAY: 1.0}


def test_a_start_in_conflict_takes_a_random_tracked_bay_that_is_another_s_goal():
    assert goals(conflict=True) == pytest.approx({3: 0.5, 8: 0.5}, abs=0.056)
    assert goals(conflict=True, others=(8, 9, 8)) == {8: 1.0}
    # Nobody heads for a tracked bay; who explores has no goal to share.
    assert goals(conflict=True, others=(9, NO_BAY)) == {NO_BAY: 1.0}


def test_first_goals_are_those_of_the_agents_that_start():
    goal = jnp.array([NO_BAY, 8, NO_BAY, NO_BAY], jnp.int32)
    begun = jnp.array([True, False, True, False])
    placing = start_placing(goal, goal, jnp.zeros((4, 3)), begun)
    placing = placing.replace(conflict=jnp.array([True, True, False, True]))
    tracked = jnp.tile(TRACKED, (4, 1))
    got = first_goals(placing, tracked, goal, begun, jax.random.key(0))
    # 0 joins agent 1, who drives on; 2 is in no conflict, 3 does not start.
    np.testing.assert_array_equal(got, [8, 8, NO_BAY, NO_BAY])
