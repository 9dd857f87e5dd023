"""Starts on collision course, rule by rule, and how often each kind of start comes.

Whether two agents would meet is worked out from where they start: both drive straight
to their goals, equally fast.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from carpark_mj.mdp.spawning.respawn import first_poses, renew
from helpers.scenes import check_occupancy, lot

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.goals import init_occupancy, new_goal
from carpark_mj.mdp.spawning.collision_course import crash_pose
from carpark_mj.mdp.spawning.poses import is_close, is_crash, spawn_pose

CRASH = SpawnConfig(close_ratio=0.0, crash_ratio=1.0)
GRID = dataclasses.replace(CRASH, grid=WORLD_UNIT / 16)
AREA = 42 * WORLD_UNIT  # m, side of the study's spawn area
# Agent 0 starts; 1 and 2 have far to go, 3 has not.
XY = np.array([[0.0, 0.0], [-9.0, -9.0], [9.0, -9.0], [9.0, 9.0]])
GOAL = np.array([[0.0, 18.0], [3.375, 18.0], [-3.375, 18.0], [13.5, 10.0]])
OTHERS = np.array([False, True, True, True])


@functools.partial(jax.jit, static_argnums=0)
def try_all(config, layout, xy, goal_xy, others, targets, keys, wall=-jnp.inf):
    def attempt(key):
        return crash_pose(
            config,
            layout,
            goal_xy[0],
            xy,
            goal_xy,
            others,
            targets,
            key,
            lambda pose: pose[:, 0] < wall,
        )

    return jax.vmap(attempt)(keys)


def attempts(
    config=CRASH, layout=None, xy=XY, goal=GOAL, targets=OTHERS, count=2000, **rest
):
    """Many attempts for agent 0: poses, and which of them succeeded."""
    layout = layout if layout is not None else make_layout("tanner")
    keys = jax.random.split(jax.random.key(0), count)
    arrays = [jnp.asarray(x, jnp.float32) for x in (xy, goal)]
    pose, found = try_all(config, layout, *arrays, OTHERS, targets, keys, **rest)
    return np.asarray(pose, np.float64), np.asarray(found)


def meetings(start, goal, other, other_goal):
    """Ways (...) driven when two agents (..., 2) are nearest, and how near that is."""

    def ahead(a, b):
        return (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)

    gap = start - other
    speed = ahead(start, goal) - ahead(other, other_goal)
    way = -np.sum(gap * speed, axis=-1) / np.sum(speed * speed, axis=-1)
    return way, np.linalg.norm(gap + way[..., None] * speed, axis=-1)


def meets(pose, xy=XY, goal=GOAL, tolerance=2e-3, config=CRASH):
    """(n, agents - 1) bool: agent 0 at poses (n, 3) would meet them by the rule.

    Where the agents are, and their goals, is (agents, 2) or (n, agents, 2).
    """
    others, ends = xy[..., 1:, :], goal[..., 1:, :]
    way, near = meetings(pose[:, None, :2], goal[..., :1, :], others, ends)
    whole = np.linalg.norm(others - ends, axis=-1)
    slack = 5 * tolerance
    allowed = way > config.min_distance - slack
    allowed &= way < whole - config.crash_distance + slack
    return (near < tolerance) & allowed


def test_both_straight_ways_reach_the_crash_point_after_equal_distance():
    pose, found = attempts()
    assert found.mean() > 0.3
    met = meets(pose[found])
    # Agent 3 has a way of 4.6 m, less than crash_distance.
    assert not met[:, 2].any()
    assert met.any(axis=1).all()
    assert not meets(pose[found] + [0.3, 0.3, 0.0]).any(axis=1).all()


def test_a_crash_start_is_in_the_spawn_area_and_far_enough_from_others():
    def farthest(side):
        layout = lot([(0.0, 20.0, 0.0)], spawn_size=(side, side))
        pose, found = attempts(layout=layout)
        assert found.any()
        gap = np.linalg.norm(pose[found, None, :2] - XY[1:], axis=-1)
        assert gap.min() > CRASH.min_distance
        return np.abs(pose[found, :2]).max()

    # Worked out apart: here starts that keep the distance are 10.80 m to 11.01 m out.
    assert farthest(21.8) <= 10.9 + 1e-5
    assert farthest(200.0) > 10.98


def test_crash_targets_are_uniform_among_those_far_enough_from_their_goals():
    # Everything is in the area, and the scene is its own mirror image.
    wide = lot([(0.0, 20.0, 0.0)], spawn_size=(200.0, 200.0))
    xy = np.array([[0.0, 0.0], [-9.0, -9.0], [9.0, -9.0], [0.0, 80.0]])
    goal = np.array([[0.0, 18.0], [9.0, 18.0], [-9.0, 18.0], [0.0, 81.0]])
    pose, found = attempts(layout=wide, xy=xy, goal=goal)
    assert found.mean() > 0.9
    met = meets(pose[found], xy, goal)
    assert met.any(axis=1).all()
    assert not met[:, 2].any()
    # Deviation 1.1 %: five of them.
    assert met[:, 0].mean() == pytest.approx(0.5, abs=0.056)


def test_the_crash_point_is_uniform_between_both_least_distances():
    wide = lot([(0.0, 20.0, 0.0)], spawn_size=(400.0, 400.0))
    xy = np.array([[0.0, 0.0], [40.0, -40.0], [90.0, 90.0], [90.0, 95.0]])
    goal = np.array([[0.0, 60.0], [40.0, 40.0], [90.0, 91.0], [90.0, 96.0]])
    pose, found = attempts(layout=wide, xy=xy, goal=goal)
    assert found.all()
    assert meets(pose, xy, goal)[:, 0].all()
    way, _ = meetings(pose[:, :2], goal[0], xy[1], goal[1])
    low, high = CRASH.min_distance, 80.0 - CRASH.crash_distance
    share = (way - low) / (high - low)
    assert share.min() > -1e-4
    assert share.max() < 1 + 1e-4
    # The shortest ways begin too near agent 1, and other points are taken.
    count = np.histogram(share, bins=8, range=(0.2, 1.0))[0]
    # Binomial with a mean of 233 or so, deviation 15: five of them.
    np.testing.assert_allclose(count, count.mean(), atol=75)


def test_without_anybody_far_enough_from_its_goal_the_attempt_fails():
    wide = lot([(0.0, 20.0, 0.0)], spawn_size=(200.0, 200.0))

    def any_found(way, targets=OTHERS):
        goal = XY + np.array([0.0, way])
        goal[0] = (0.0, -18.0)
        return attempts(layout=wide, goal=goal, targets=targets)[1].any()

    assert not any_found(7.3)
    # 14 m are enough to be chosen, but leave no room between both distances.
    assert not any_found(14.0)
    assert any_found(15.0)
    assert not any_found(15.0, np.zeros(4, bool))


def test_only_agents_that_drive_are_crash_targets():
    pose, found = attempts(targets=np.array([False, False, True, False]))
    assert found.any()
    assert meets(pose[found])[:, 1].all()


def test_crash_starts_are_where_the_car_touches_nothing():
    pose, found = attempts(wall=jnp.float32(0.0))
    assert found.any()
    assert pose[found, 0].min() >= 0.0
    assert attempts()[0][:, 0].min() < 0.0


def test_crash_headings_are_random():
    pose, found = attempts()
    count = np.histogram(pose[found, 2], bins=8, range=(-np.pi, np.pi))[0]
    mean = found.sum() / 8
    assert ((count - mean) ** 2 / mean).sum() < 24.4  # 0.1 % quantile, 7 degrees


def test_on_a_grid_crash_starts_are_its_nearest_points():
    pose, found = attempts(GRID)
    point = pose[found, :2] / GRID.grid
    np.testing.assert_allclose(point, np.round(point), atol=1e-3)
    assert np.abs(pose[found, :2]).max() <= AREA / 2 + 1e-5
    # Off the course by half a diagonal at most, 25 mm.
    assert meets(pose[found], tolerance=0.05, config=GRID).any(axis=1).all()


# Starts as the environment makes them

AGENTS, CARS = 7, 16
MIXED = SpawnConfig(close_ratio=0.2, crash_ratio=0.5, close_distance=0.5)


def lots(count, seed=1):
    """Random occupancies and poses of seven agents, numpy-friendly."""
    layout = make_layout("tanner")
    keys = jax.random.split(jax.random.key(seed), count)
    occupancy = jax.vmap(lambda key: init_occupancy(layout, AGENTS, CARS, key))(keys)
    pose = np.random.default_rng(seed).uniform(-AREA / 2, AREA / 2, (count, AGENTS, 3))
    return layout, occupancy, jnp.asarray(pose, jnp.float32)


@functools.partial(jax.jit, static_argnums=0)
def renew_all(config, layout, occupancy, pose, done, parked, keys):
    def one(occupancy, pose, key):
        return renew(
            config,
            layout,
            occupancy,
            pose,
            done,
            parked,
            key,
            (None, None),
            lambda *_: None,
            2,
        )

    return jax.vmap(one)(occupancy, pose, keys)


FIRST = np.arange(AGENTS) == 0


def renewed(config, count=2000, done=FIRST):
    layout, occupancy, pose = lots(count)
    keys = jax.random.split(jax.random.key(2), count)
    after, start = renew_all(
        config, layout, occupancy, pose, done, ~FIRST & FIRST, keys
    )
    return layout, occupancy, jax.device_get(after), np.asarray(start, np.float64)


def on_course(layout, after, start):
    """Lots in which agent 0 starts on a collision course with somebody."""
    goal = np.asarray(layout.bay_pose, np.float64)[after.goal, :2]
    return meets(start[:, 0], start[..., :2], goal).any(axis=1)


def wanted(count=2000):
    """Lots in which agent 0 is to start close, and on a collision course."""
    keys = jax.random.split(jax.random.key(2), count)

    def kinds(key):
        spawn_key = jax.random.split(jax.random.fold_in(key, 0))[1]
        return is_close(MIXED, spawn_key), is_crash(MIXED, spawn_key)

    return np.asarray(jax.vmap(kinds)(keys))


def test_close_crash_and_random_starts_come_in_their_ratios():
    layout, _, after, start = renewed(MIXED)
    close, crash = wanted()
    assert not (close & crash).any()
    # Deviations 0.9 % and 1.1 %: five of them.
    assert close.mean() == pytest.approx(0.2, abs=0.045)
    assert crash.mean() == pytest.approx(0.5, abs=0.056)
    course = on_course(layout, after, start)
    assert not course[~crash].any()
    assert course[crash].mean() > 0.7  # of ten attempts one succeeds, among six others
    goal = np.asarray(layout.bay_pose)[after.goal[:, 0], :2]
    nearest = np.clip(goal, -AREA / 2, AREA / 2)
    near = np.linalg.norm(start[:, 0, :2] - nearest, axis=1) <= 0.5 + 1e-4
    assert near[close].mean() > 0.4  # where no other agent is
    assert near[~close].mean() < 0.01


def test_a_crash_start_has_a_new_goal_that_is_nobody_s_and_no_car_s():
    layout, before, after, start = renewed(MIXED)
    check_occupancy(after.goal, after.parked_bay, np.ones((2000, 36), bool))
    assert (after.goal[:, 0] != np.asarray(before.goal)[:, 0]).all()
    np.testing.assert_array_equal(after.goal[:, 1:], before.goal[:, 1:])
    gap = np.linalg.norm(start[:, :1, :2] - start[:, 1:, :2], axis=-1).min(axis=1)
    course = on_course(layout, after, start)
    assert course.any()
    assert gap[course].min() > MIXED.min_distance


def test_two_that_end_together_are_no_targets_of_each_other_until_they_start():
    both = np.arange(AGENTS) < 2
    layout, _, after, start = renewed(MIXED, done=both)
    check_occupancy(after.goal, after.parked_bay, np.ones((2000, 36), bool))
    old = np.asarray(lots(2000)[2], np.float64)
    goal = np.asarray(layout.bay_pose, np.float64)[after.goal, :2]
    # Agent 0 starts first, when agent 1 still stands where its episode ended.
    way, near = meetings(start[:, 0, :2], goal[:, 0], start[:, 2:, :2].swapaxes(0, 1),
                         goal[:, 2:].swapaxes(0, 1))  # fmt: skip
    del way
    assert (near.min(axis=0) < 2e-3)[wanted()[1]].mean() > 0.7
    assert np.abs(old[:, 2:] - start[:, 2:]).max() < 1e-6


def test_without_crash_starts_draws_are_what_they_were_before_there_were_any():
    """The goal and the pose come from the two parts of the agent's key, as ever."""
    config = SpawnConfig()
    layout, occupancy, pose = lots(200)
    keys = jax.random.split(jax.random.key(2), 200)

    def by_hand(occupancy, pose, key):
        goal_key, spawn_key = jax.random.split(jax.random.fold_in(key, 0))
        xy = pose[:, :2]
        after = new_goal(layout, occupancy, 0, xy, config.min_distance, goal_key)
        goal_pose = layout.bay_pose[after.goal[0]]
        others = jnp.arange(AGENTS) != 0
        start = spawn_pose(config, layout, goal_pose, xy, others, spawn_key)
        return after, start

    after, start = jax.jit(jax.vmap(by_hand))(occupancy, pose, keys)
    _, _, found, poses = renewed(config, 200)
    np.testing.assert_array_equal(found.goal, after.goal)
    np.testing.assert_array_equal(found.parked_bay, after.parked_bay)
    np.testing.assert_allclose(poses[:, 0], start, atol=2e-6)  # float32


def test_at_a_reset_agents_start_on_course_for_those_placed_before_them():
    layout, occupancy, _ = lots(300)
    keys = jax.random.split(jax.random.key(5), 300)

    def place(occupancy, key):
        return first_poses(CRASH, layout, occupancy, key, lambda *_: None)

    pose = np.asarray(jax.jit(jax.vmap(place))(occupancy, keys), np.float64)
    goal = np.asarray(layout.bay_pose, np.float64)[np.asarray(occupancy.goal), :2]
    met = np.zeros(AGENTS)
    for agent in range(1, AGENTS):
        order = [agent, *range(agent)]
        lots_met = meets(pose[:, agent], pose[:, order, :2], goal[:, order])
        met[agent] = lots_met.any(axis=1).mean()
    assert met[1] > 0.1  # of a single target; its way is often too short
    assert (met[3:] > 0.35).all()  # and later there is less and less room
    check_occupancy(occupancy.goal, occupancy.parked_bay, np.ones((300, 36), bool))
