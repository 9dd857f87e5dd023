"""Starts on a collision course, askew in the bay, and on ways out of it."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.rules import LIMITS
from helpers.scenes import cars, lot, polygons, solid
from helpers.spawning import (
    begun,
    meetings,
    meets,
    misaligned,
    placing_one,
    surroundings_of,
    walled,
)
from helpers.states import parked_at, parked_in

from carpark_mj.config import WORLD_UNIT, SpawnConfig
from carpark_mj.layouts import layout_config, layout_maxima, make_layout, pad_layout
from carpark_mj.mdp.parked_cars import fits
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.spawning.fleet import shuffled_bays
from carpark_mj.spawning.placing import SpawnInputs, start_placing, surroundings
from carpark_mj.spawning.special_starts import (
    FARTHEST,
    LONGEST,
    MARGIN,
    NEAREST,
    REVERSE_SHAPES,
    ROOM,
    SPACING,
    Targets,
    course_pose,
    course_shapes,
    paths_out,
    reverse_pose,
)
from carpark_mj.spawning.starts import draw_uniform
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle

COURSE = SpawnConfig(close_ratio=0.0, conflict_ratio=1.0)
SPACED = dataclasses.replace(COURSE, spacing=WORLD_UNIT / 16)
AREA = 42 * WORLD_UNIT  # m, side of the study's spawn area
# Agent 0 starts; 1 and 2 have far to go, 3 has not.
XY = np.array([[0.0, 0.0], [-9.0, -9.0], [9.0, -9.0], [9.0, 9.0]])
GOAL = np.array([[0.0, 18.0], [3.375, 18.0], [-3.375, 18.0], [13.5, 10.0]])
OTHERS = np.array([False, True, True, True])


@functools.partial(jax.jit, static_argnums=0)
def try_all(config, layout, around, goal_xy, targets, keys):
    def attempt(key):
        draws = draw_uniform(course_shapes(4), key)
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


def test_both_reach_the_crash_point_after_equal_distance():
    pose, found = attempts()
    assert found.mean() > 0.3
    met = meets(COURSE, pose[found], XY, GOAL)
    # Agent 3 has a way of 4.6 m, less than conflict_distance.
    assert not met[:, 2].any()
    assert met.any(axis=1).all()
    assert not meets(COURSE, pose[found] + [0.3, 0.3, 0.0], XY, GOAL).any(axis=1).all()


def test_crash_start_is_in_the_area_and_keeps_its_distance():
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


def test_crash_targets_are_uniform_if_far_from_goals():
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


def test_crash_start_fails_without_a_far_target():
    wide = lot([(0.0, 20.0, 0.0)], spawn_size=(200.0, 200.0))

    def any_found(way, targets=OTHERS):
        goal = XY + np.array([0.0, way])
        goal[0] = (0.0, -18.0)
        return attempts(layout=wide, goal=goal, targets=targets)[1].any()

    assert not any_found(7.3)
    # 14 m are enough to be chosen, but leave no room between both distances.
    assert not any_found(14.0)
    assert any_found(15.0)
    assert not any_found(15.0, np.zeros(4, bool))  # agents that drive alone count
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


MISALIGNED = SpawnConfig(close_ratio=0.0, misaligned_ratio=1.0)
BAY = (20.0, 0.0, 0.5)
COUNT = 1500


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


def test_misaligned_starts_cross_the_lines_of_the_bay():
    pose = begun(TIGHT, MISALIGNED, count=COUNT)
    along, across, askew, way = in_bay(pose)
    for values, most in zip((along, across, askew), FARTHEST, strict=True):
        assert 0.9 * most < np.abs(values).max() < most + 1e-3
        assert abs(values.mean()) < 0.1 * most
    assert 0.4 < (way > 0).mean() < 0.6
    bay = polygons(np.array([BAY]), np.array([TIGHT.bay_size[0]]))[0]
    assert not shapely.contains(bay, polygons(pose, SIZE)).any()
    bays = np.broadcast_to(BAY, pose.shape), np.tile(TIGHT.bay_size[0], (COUNT, 1))
    inside = [name for name, limits in LIMITS.items() if limits.inside_lines]
    assert "strict" in inside
    for rule in inside:
        assert not is_parked(rule, cars(pose, size=SIZE), *bays).any()


def test_they_overlap_neither_an_agent_nor_a_parked_car():
    beside = [(-np.sin(BAY[2]) * y, np.cos(BAY[2]) * y) for y in (2.2, -2.2)]
    near = np.array([[BAY[0] + x, BAY[1] + y, BAY[2]] for x, y in beside])
    parked = parked_at(near[:1], SIZE)
    both = jax.tree.map(lambda x: jnp.stack([x, x]), make_vehicle(COMPACT))
    sizes = jnp.broadcast_to(jnp.array(SIZE), (2, 2))
    inputs = SpawnInputs(TIGHT, parked, sizes, sizes, cars=both)
    placing = placing_one(inputs, [0, 1], [np.zeros(3), near[1]])
    pose, found = misaligned(inputs, placing, COUNT, 4)
    assert found.mean() > 0.9
    own = polygons(pose[found], SIZE)
    cars_beside = polygons(near, SIZE)
    assert shapely.distance(cars_beside[0], own).min() > MARGIN - 1e-3
    assert 0.0 < shapely.distance(cars_beside[1], own).min() < MARGIN


def test_starts_that_would_be_within_the_lines_are_random():
    sizes = {"bay_size": (SIZE[0] + 2.0, SIZE[1] + 2.0), "spawn_size": (1.0, 1.0)}
    wide = lot(TIGHT.bay_pose, **sizes)
    assert np.abs(begun(wide, MISALIGNED)[:, :2]).max() <= 0.5


# Reverse starts: free of everything, and the way back ends parked in the bay


REVERSE = SpawnConfig(close_ratio=0.0, reverse_ratio=1.0)
FAMILIES = ("square", "street_parallel", "angled", "lot", "dead_end")
LOTS, PARKED = 120, 20


@functools.cache
def maxima():
    key = jax.random.key(0)
    makers = (layout_config(f).generate for f in FAMILIES)
    return layout_maxima(jax.eval_shape(make, key) for make in makers)


@jax.jit
def reverse_starts(layouts, cars, keys):
    """Agent 0 in each lot, with agent 1 anywhere near its goal."""

    def one(layout, cars, key):
        bay_key, near_key, draw_key = jax.random.split(key, 3)
        order = shuffled_bays(layout, bay_key)
        goal = order[:2]
        bay = order[2 : 2 + PARKED]
        bay = jnp.where(layout.bay_mask[bay], bay, NO_BAY)
        parked = parked_in(layout, bay, SIZE)
        near = jax.random.uniform(near_key, (3,), minval=-6.0, maxval=6.0)
        pose = layout.bay_pose[goal[0]] + near
        inputs = SpawnInputs(layout, parked, cars=cars)
        waiting = jnp.array([True, False])
        placing = start_placing(goal, bay, jnp.stack([pose, pose]), waiting)
        draws = draw_uniform(REVERSE_SHAPES, draw_key)
        around = surroundings(inputs, placing, jnp.array(0))
        start = reverse_pose(inputs, placing, around, jnp.array(0), draws)
        return start, draws, goal[0], pose, parked

    return jax.vmap(one)(layouts, cars, keys)


def check_drivable(path, cars):
    """Asserts that cars can drive paths (n, ways, k, 3) of their centres.

    Rear axles may slip by millimetres where an arc ends between two poses.
    """
    ahead, base, lock = (
        np.asarray(x, np.float64)[:, :1, None]
        for x in (cars.centre_offset, cars.wheelbase, cars.max_steering)
    )
    x, y, yaw = np.moveaxis(np.asarray(path, np.float64), -1, 0)
    step = np.diff(x + 1j * y - ahead * np.exp(1j * yaw))
    turn = np.angle(np.exp(1j * np.diff(yaw)))
    step = step * np.exp(-1j * (yaw[..., :-1] + turn / 2))  # in the mean heading
    assert np.abs(step.imag).max() < 5e-3
    assert np.abs(step.real).max() < SPACING + 1e-4
    assert (np.abs(turn) < SPACING * np.tan(lock) / base + 1e-4).all()


@pytest.mark.parametrize("name", FAMILIES)
def test_a_start_is_free_and_the_way_back_ends_parked_in_the_bay(name):
    config = layout_config(name)
    make = lambda key: pad_layout(config.generate(key), maxima())  # noqa: E731
    keys = jax.random.split(jax.random.key(0), LOTS)
    layouts = jax.jit(jax.vmap(make))(keys)
    each = [*map(make_vehicle, PRESETS.values())] * LOTS  # more than enough
    fleet = jax.tree.map(lambda *x: np.stack([x[:LOTS]] * 2, axis=1), *each)
    (pose, found), draws, goal, other, parked = reverse_starts(
        layouts, fleet, jax.random.split(jax.random.key(1), LOTS)
    )
    number = np.arange(LOTS)
    bay_pose, bay_size = layouts.bay_pose[number, goal], layouts.bay_size[number, goal]
    size = fleet.size[:, 0]
    own = np.asarray(jax.vmap(fits)(bay_size[:, None], size))[:, 0]
    found = np.asarray(found) & own
    assert found.sum() > 0.4 * own.sum()  # agent 1 stands in the way of many

    start = np.asarray(pose, np.float64)
    room = shapely.distance(polygons(start, size), polygons(other, size))
    assert room[found].min() > ROOM - 1e-3
    away = np.linalg.norm(start[:, :2] - bay_pose[:, :2], axis=1)[found]
    assert NEAREST - 1e-3 < away.min() < 3.0
    assert 4.0 < away.max() < LONGEST

    paths = jax.vmap(paths_out, (0, None, 0, 0))(fleet, jnp.array(0), bay_pose, draws)
    check_drivable(paths, fleet)
    off = np.linalg.norm(paths[..., :2] - start[:, None, None, :2], axis=-1)
    way, at = np.divmod(off.reshape(LOTS, -1).argmin(axis=1), off.shape[-1])
    assert off[number, way, at][found].max() < 1e-3  # it is a point of one of them
    way = np.asarray(paths, np.float64)[number, way]
    way[..., 2] = np.unwrap(way[..., 2])
    there = cars(way[:, 0], size=size)
    # Who is 5 m from a bay's end, where starts are, has arrived as MetaDrive has it.
    rules = [name for name, limits in LIMITS.items() if limits.from_end is None]
    parks = {rule: is_parked(rule, there, bay_pose, bay_size) for rule in rules}
    standing = cars(start, size=size)
    for rule, good in parks.items():
        assert np.asarray(good)[found].all(), rule
        begun = is_parked(rule, standing, bay_pose, bay_size)
        assert not np.asarray(begun)[found].any(), rule
    nose_in = np.cos(way[:, 0, 2] - bay_pose[:, 2])[found]
    np.testing.assert_allclose(np.abs(nose_in), 1.0, atol=1e-3)
    assert (nose_in > 0).any()
    assert (nose_in < 0).any()

    plans = jax.device_get(layouts)
    stands = jax.device_get(parked)
    for k in np.flatnonzero(found):
        plan = jax.tree.map(lambda x, k=k: x[k], plans)
        here = stands.present[k]
        parked_cars = polygons(stands.pose_w[k, here], stands.size[k, here])
        taken = shapely.union_all([solid(plan), *parked_cars])
        assert taken.distance(polygons(start[k], size[k])) > MARGIN - 1e-3
        back = way[k, : at[k] + 1]
        back = np.concatenate([back, (back[1:] + back[:-1]) / 2])
        assert not shapely.intersects(taken, polygons(back, size[k])).any()


FAR = lot([(20.0, 0.0, np.pi), (20.0, 40.0, 0.0)], spawn_size=(1.0, 1.0))


@pytest.mark.parametrize(
    ("layout", "ratio"), [(TIGHT, "misaligned_ratio"), (FAR, "reverse_ratio")]
)
def test_their_share_is_the_ratio_others_are_random(layout, ratio):
    mixed = SpawnConfig(close_ratio=0.1, **{ratio: 0.3})
    x = begun(layout, mixed)[:, 0]
    # Deviation 1.2 %: five of them. Others start within 1 m of the origin.
    assert (x > 5.0).mean() == pytest.approx(0.3, abs=0.06)
    assert (np.abs(x) <= 0.5).mean() == pytest.approx(0.7, abs=0.06)


def test_a_start_falls_back_to_random_where_no_way_leads_out():
    walls = [(20.0, 1.2, 0.0), (20.0, -1.2, 0.0), (17.2, 0.0, 1.57), (22.8, 0.0, 1.57)]
    closed = lot(FAR.bay_pose, walls, wall_size=(6.0, 0.2), spawn_size=(1.0, 1.0))
    assert np.abs(begun(closed, REVERSE)[:, 0]).max() <= 0.5
    agents = [(20.0 + 6.0 * x, 6.0 * y, 0.0) for x in (-1, 0, 1) for y in (-1, 0, 1)]
    agents = [(0.0, 40.0, 0.0), *agents]  # who leave no room
    assert np.abs(begun(FAR, REVERSE, agents)[:, 0]).max() <= 0.5
