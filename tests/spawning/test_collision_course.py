"""Starts on collision course, rule by rule.

Whether two agents would meet is worked out from where they start: both drive straight
to their goals, equally fast.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import lot
from helpers.spawning import meetings, meets, surroundings_of, walled

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import make_layout
from carpark_mj.spawning.special_starts import (
    CourseDraws,
    Targets,
    course_pose,
    course_shapes,
)
from carpark_mj.spawning.starts import draw_uniform

COURSE = SpawnConfig(close_ratio=0.0, conflict_ratio=1.0)
SPACED = dataclasses.replace(COURSE, spacing=WORLD_UNIT / 16)
AREA = 42 * WORLD_UNIT  # m, side of the study's spawn area
# Agent 0 starts; 1 and 2 have far to go, 3 has not.
XY = np.array([[0.0, 0.0], [-9.0, -9.0], [9.0, -9.0], [9.0, 9.0]])
GOAL = np.array([[0.0, 18.0], [3.375, 18.0], [-3.375, 18.0], [13.5, 10.0]])
OTHERS = np.array([False, True, True, True])


@functools.partial(jax.jit, static_argnums=0)
def try_all(config, layout, around, goal_xy, targets, keys):
    shapes = CourseDraws(*(shape[1:] for shape in course_shapes(config, 4)))

    def attempt(key):
        draws = draw_uniform(shapes, key)
        return course_pose(config, layout, around, goal_xy, targets, draws)

    return jax.vmap(attempt)(keys)


def attempts(
    config=COURSE, layout=None, xy=XY, goal=GOAL, targets=OTHERS, size=None, count=2000
):
    """Many attempts for agent 0: poses, and which of them succeeded."""
    layout = layout if layout is not None else make_layout("square")
    keys = jax.random.split(jax.random.key(0), count)
    xy, goal = (jnp.asarray(x, jnp.float32) for x in (xy, goal))
    around = surroundings_of(layout, xy, OTHERS, size)
    targets = Targets(xy, goal, jnp.asarray(targets))
    pose, found = try_all(config, layout, around, goal[0], targets, keys)
    return np.asarray(pose, np.float64), np.asarray(found)


def test_both_straight_ways_reach_the_crash_point_after_equal_distance():
    pose, found = attempts()
    assert found.mean() > 0.3
    met = meets(COURSE, pose[found], XY, GOAL)
    # Agent 3 has a way of 4.6 m, less than conflict_distance.
    assert not met[:, 2].any()
    assert met.any(axis=1).all()
    assert not meets(COURSE, pose[found] + [0.3, 0.3, 0.0], XY, GOAL).any(axis=1).all()


def test_a_crash_start_is_in_the_spawn_area_and_far_enough_from_others():
    def farthest(side):
        layout = lot([(0.0, 20.0, 0.0)], spawn_size=(side, side))
        pose, found = attempts(layout=layout)
        assert found.any()
        gap = np.linalg.norm(pose[found, None, :2] - XY[1:], axis=-1)
        assert gap.min() > COURSE.min_distance
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
    met = meets(COURSE, pose[found], xy, goal)
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
    assert meets(COURSE, pose, xy, goal)[:, 0].all()
    way, _ = meetings(pose[:, :2], goal[0], xy[1], goal[1])
    low, high = COURSE.min_distance, 80.0 - COURSE.conflict_distance
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
    assert meets(COURSE, pose[found], XY, GOAL)[:, 1].all()


def test_crash_starts_are_where_the_car_touches_nothing():
    # A wall fills the left half: of a car of 4 m by 2 m no corner is there.
    layout = walled(make_layout("square"), (-10.0, 0.0, 0.0), (20.0, 60.0))
    pose, found = attempts(layout=layout, size=(4.0, 2.0))
    assert found.any()
    x, _, yaw = pose[found].T
    assert (x - 2.0 * np.abs(np.cos(yaw)) - np.abs(np.sin(yaw))).min() > -1e-5
    assert attempts()[0][:, 0].min() < 0.0


def test_on_a_grid_crash_starts_are_its_nearest_points():
    pose, found = attempts(SPACED)
    point = pose[found, :2] / SPACED.spacing
    np.testing.assert_allclose(point, np.round(point), atol=1e-3)
    assert np.abs(pose[found, :2]).max() <= AREA / 2 + 1e-5
    # Off the course by half a diagonal at most, 25 mm.
    assert meets(SPACED, pose[found], XY, GOAL, 0.05).any(axis=1).all()
