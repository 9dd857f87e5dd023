import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import overlap_oracle, polygons

from carpark_mj import geometry
from carpark_mj.geometry import (
    box_distance,
    norm,
    ray_box_distance,
    reeds_shepp_length,
    se2,
    to_world,
)

PAIRS = 6000


def random_boxes(rng, count, reach=6.0, longest=8.0):
    pose = rng.uniform([-reach, -reach, -4.0], [reach, reach, 4.0], (count, 3))
    return np.float32(pose), np.float32(rng.uniform(0.5, longest, (count, 2)))


@pytest.fixture(scope="module")
def pairs():
    rng = np.random.default_rng(0)
    return (*random_boxes(rng, PAIRS), *random_boxes(rng, PAIRS))


def test_boxes_overlap_agrees_with_shapely(pairs):
    expected, certain = overlap_oracle(*pairs)
    got = np.asarray(geometry.boxes_overlap(*pairs))
    np.testing.assert_array_equal(got[certain], expected[certain])
    assert (~certain).sum() <= 5
    assert 0.2 < expected.mean() < 0.8  # both answers are well represented


def test_boxes_that_only_touch_or_hold_nan_do_not_overlap():
    size = jnp.array([4.0, 2.0])
    beside = jnp.array([[4.0, 0.0, 0.0], [0.0, 2.0, 0.0], [-4.0, 2.0, 0.0]])
    assert not geometry.boxes_overlap(jnp.zeros(3), size, beside, size).any()
    nearer = beside * (1.0 - 1e-3)
    assert geometry.boxes_overlap(jnp.zeros(3), size, nearer, size).all()
    nan = jnp.array([[jnp.nan, 0, 0], [0, jnp.nan, 0], [0, 0, jnp.nan]])
    assert not geometry.boxes_overlap(nan, size, jnp.zeros(3), size).any()
    assert not geometry.boxes_overlap(jnp.zeros(3), size, nan, size).any()


def test_inside_and_room_are_shapely_s_and_those_of_the_corners():
    rng = np.random.default_rng(1)
    pose_a, size_a = random_boxes(rng, PAIRS, 1.5, 4.0)
    pose_b, size_b = random_boxes(rng, PAIRS, 1.5, 4.0)
    size_b = size_b + np.float32(3.0)
    corners = shapely.get_coordinates(polygons(pose_a, size_a)).reshape(PAIRS, 5, 2)
    offset = corners - pose_b[:, None, :2]
    cos, sin = np.cos(pose_b[:, 2:]), np.sin(pose_b[:, 2:])
    x = offset[..., 0] * cos + offset[..., 1] * sin
    y = offset[..., 1] * cos - offset[..., 0] * sin
    (a, b), x, y = 0.5 * size_b.T, x.T, y.T
    gaps = [a - x.max(axis=0), a + x.min(axis=0), b - y.max(axis=0), b + y.min(axis=0)]
    expected = np.stack(gaps, axis=1)
    room = np.asarray(geometry.box_room(pose_a, size_a, pose_b, size_b))
    np.testing.assert_allclose(room, expected, atol=2e-5)
    inner = polygons(pose_a, size_a)
    smaller = shapely.covers(polygons(pose_b, size_b - 2e-4), inner)
    larger = shapely.covers(polygons(pose_b, size_b + 2e-4), inner)
    certain = smaller == larger
    got = np.asarray(geometry.box_inside(pose_a, size_a, pose_b, size_b))
    np.testing.assert_array_equal(got[certain], larger[certain])
    assert (~certain).sum() <= 5
    assert 0.2 < larger.mean() < 0.8
    pose, size = jnp.array([1.0, 2.0, 0.0]), jnp.array([4.0, 2.0])
    assert geometry.box_inside(pose, size, pose, size)
    for less in ([1e-3, 0.0], [0.0, 1e-3]):
        assert not geometry.box_inside(pose, size, pose, size - jnp.array(less))


def test_distances_of_boxes_and_points_agree_with_shapely(pairs):
    expected = shapely.distance(polygons(*pairs[:2]), polygons(*pairs[2:]))
    got = geometry.box_distance(*pairs)
    # Coordinates up to 12 m resolve 1e-6 m in float32; a few roundings add up.
    np.testing.assert_allclose(got, expected, atol=2e-5)
    assert (expected > 0.1).sum() > PAIRS / 5
    pose, size = pairs[:2]
    point = np.random.default_rng(2).uniform(-9, 9, (PAIRS, 2)).astype(np.float32)
    expected = shapely.distance(polygons(pose, size), shapely.points(point))
    got = geometry.point_box_distance(point, pose, size)
    np.testing.assert_allclose(got, expected, atol=2e-5)  # float32, as above
    assert (expected == 0).sum() > 100


def test_ahead_is_x_left_is_y_and_moving_keeps_the_heading():
    north = jnp.array([1.0, 2.0, np.pi / 2])
    there = geometry.move_forward(north, 3.0)
    np.testing.assert_allclose(there, [1.0, 5.0, np.pi / 2], atol=1e-6)
    np.testing.assert_allclose(geometry.to_local(north, there), [3, 0, 0], atol=1e-6)
    left = geometry.to_local(north, jnp.array([-1.0, 2.0, jnp.pi]))
    np.testing.assert_allclose(left, [0.0, 2.0, jnp.pi / 2], atol=1e-6)
    pose, distance = random_boxes(np.random.default_rng(2), 500)
    ahead = np.stack([distance[:, 0], np.zeros(500), np.zeros(500)], -1)
    moved = geometry.move_forward(pose, distance[:, 0])
    np.testing.assert_allclose(
        moved[:, :2], geometry.to_world(pose, ahead)[:, :2], atol=1e-5
    )
    np.testing.assert_array_equal(moved[:, 2], pose[:, 2])


def test_wrapped_angles_lie_in_minus_pi_to_below_pi():
    rng = np.random.default_rng(4)
    edges = np.float32(np.pi * np.arange(-9, 10))
    around = [np.nextafter(edges, np.float32(s * np.inf)) for s in (-1, 1)]
    angles = np.float32([*rng.uniform(-60, 60, 5000), *edges, *np.concatenate(around)])
    wrapped = np.asarray(geometry.wrap_angle(jnp.asarray(angles)))
    assert (wrapped >= -np.float32(np.pi)).all()
    assert (wrapped < np.float32(np.pi)).all()
    # The remainder of the division, bit for bit.
    by_mod = jnp.mod(jnp.asarray(angles) + jnp.pi, 2 * jnp.pi) - jnp.pi
    np.testing.assert_array_equal(wrapped, by_mod)
    # The same direction: float32 angles of 60 rad resolve 4e-6 rad.
    turn = np.exp(1j * wrapped.astype(np.float64)) - np.exp(1j * np.float64(angles))
    assert np.abs(turn).max() < 1e-5


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0, 0), (30, 30), (-30, 30), (90, 90), (120, 60), (180, 0), (-175, 5), (359, 1)],
)
def test_axis_angle_error_is_the_same_nose_in_and_nose_out(degrees, expected):
    error = geometry.axis_angle_error(jnp.radians(jnp.float32(degrees)))
    # float32 angles of 6 rad resolve 5e-7 rad = 3e-5 deg, doubled by the function.
    assert float(jnp.degrees(error)) == pytest.approx(expected, abs=1e-4)


def test_corners_go_counter_clockwise_from_front_left():
    pose = jnp.array([1.0, 2.0, jnp.pi / 2])  # front is north, left is west
    corners = geometry.box_corners(pose, jnp.array([4.0, 2.0]))
    expected = [[0.0, 4.0], [0.0, 0.0], [2.0, 0.0], [2.0, 4.0]]
    np.testing.assert_allclose(corners, expected, atol=1e-6)  # cos(pi/2) = -4e-8
    assert shapely.Polygon(np.asarray(corners)).exterior.is_ccw


def test_box_disc_overlap_and_distance_agree_with_shapely():
    rng = np.random.default_rng(6)
    pose, size = random_boxes(rng, PAIRS)
    centre = rng.uniform(-6, 6, (PAIRS, 2)).astype(np.float32)
    radius = rng.uniform(0.1, 3.0, PAIRS).astype(np.float32)
    gap = shapely.distance(polygons(pose, size), shapely.points(centre)) - radius
    got = geometry.box_disc_distance(pose, size, centre, radius)
    np.testing.assert_allclose(got, np.maximum(gap, 0.0), atol=2e-5)  # float32
    certain = np.abs(gap) > 1e-4
    got = np.asarray(geometry.box_disc_overlap(pose, size, centre, radius))
    np.testing.assert_array_equal(got[certain], (gap < 0)[certain])
    assert (~certain).sum() <= 5
    assert 0.2 < (gap < 0).mean() < 0.8


def test_discs_that_only_touch_or_hold_nan_overlap_nothing():
    pose, size = jnp.zeros(3), jnp.array([4.0, 2.0])
    # Ahead, at the left, and a 3-4-5 triangle off the front left corner.
    centre = jnp.array([[3.0, 0.0], [0.0, 2.0], [5.0, 5.0]])
    radius = jnp.array([1.0, 1.0, 5.0])
    assert not geometry.box_disc_overlap(pose, size, centre, radius).any()
    assert geometry.box_disc_overlap(pose, size, centre, radius * 1.001).all()
    for nan in ((centre * jnp.nan, radius), (centre, radius * jnp.nan)):
        assert not geometry.box_disc_overlap(pose, size, *nan).any()


@pytest.mark.parametrize("spread", [0.0, 0.1, 0.5, 1.3, np.pi])
def test_swept_half_size_is_the_bounding_box_of_all_headings(spread):
    size = np.float32([4.255, 1.799])
    yaw = np.linspace(-spread, spread, 20_001)
    pose = np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw], axis=1)
    bounds = shapely.bounds(polygons(pose, np.broadcast_to(size, (yaw.size, 2))))
    got = geometry.swept_half_size(jnp.asarray(size), jnp.asarray(spread))
    np.testing.assert_allclose(got, bounds[:, 2:].max(axis=0), atol=1e-5)


BOX = jnp.array([4.0, 2.0])


def gap(pose):
    return box_distance(pose, BOX, jnp.zeros(3), BOX)


def ray(origin):
    return ray_box_distance(origin, jnp.array([0.0, 1.0]), jnp.zeros(3), BOX)


def way(pose):
    return reeds_shepp_length(pose, jnp.zeros(3), jnp.array(4.0))


@functools.cache
def slope(function):
    return jax.jit(jax.grad(function))


@pytest.mark.parametrize(
    ("function", "where"),
    [
        (norm, (0.0, 0.0)),
        (gap, (0.0, 0.0, 0.0)),
        (gap, (4.0, 0.0, 0.0)),
        (ray, (1.0, -5.0)),
        (ray, (3.0, -5.0)),
        (way, (0.0, 0.0, 0.0)),
        (way, (-5.0, 0.0, 0.0)),
        (way, (-16.0, 0.0, 0.0)),
    ],
    ids=["norm", "same box", "touching", "hit", "miss", "there", "ahead", "far"],
)
def test_gradients_are_finite_at_corners(function, where):
    assert np.isfinite(slope(function)(jnp.array(where))).all()


@pytest.mark.parametrize(
    ("function", "where"),
    [(gap, (5.0, 1.0, 0.3)), (ray, (1.0, -5.0)), (way, (-3.0, 2.5, 0.8))],
    ids=["gap", "ray", "way"],
)
def test_gradients_elsewhere_are_central_differences(function, where):
    with jax.enable_x64(True):
        found, where = slope(function)(jnp.array(where)), np.array(where)
        value = jax.jit(function)
        for k, step in enumerate(1e-6 * np.eye(len(where))):
            gained = value(where + step) - value(where - step)
            assert found[k] == pytest.approx(float(gained) / 2e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("name", "args"), [("sqrt", (2.0,)), ("arccos", (0.3,)), ("arctan2", (3.0, -4.0))]
)
def test_values_and_slopes_are_those_of_the_function(name, args):
    ours, theirs = (getattr(home, name) for home in (se2, jnp))
    args = [jnp.float32(x) for x in args]
    every = tuple(range(len(args)))
    assert ours(*args) == theirs(*args)
    assert jax.grad(ours, every)(*args) == jax.grad(theirs, every)(*args)


def test_a_slope_that_is_not_finite_is_0_for_its_argument_only():
    times = se2.finite_slope(lambda a, b: a * jnp.sqrt(b))
    assert jax.grad(times, (0, 1))(2.0, 0.0) == (0.0, 0.0)
    assert jax.grad(times, (0, 1))(2.0, 4.0) == (2.0, 0.5)


length = jax.jit(reeds_shepp_length)


def random_poses(count, seed=0):
    rng = np.random.default_rng(seed)
    return jnp.float32(rng.uniform((-8, -8, -3.14), (8, 8, 3.14), (count, 3)))


def test_lengths_are_those_of_ompl():
    base = pytest.importorskip("ompl.base")
    space = base.ReedsSheppStateSpace(1.7)
    start, end = space.allocState(), space.allocState()
    start.setXY(0.0, 0.0)
    start.setYaw(0.0)
    goal = np.concatenate([0.05 * random_poses(100, 1), random_poses(400)])
    goal[:100, 2] *= 20.0  # close by, with any heading
    expected = []
    for x, y, yaw in goal.tolist():
        end.setXY(x, y)
        end.setYaw(yaw)
        expected.append(space.distance(start, end))
    got = length(jnp.zeros_like(goal), jnp.asarray(goal), jnp.float32(1.7))
    # On 20,000 random poses the largest difference was 1.2e-5 m.
    np.testing.assert_allclose(got, expected, atol=5e-5)


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ((5.0, 0.0, 0.0), 5.0),  # ahead
        ((-5.0, 0.0, 0.0), 5.0),  # in reverse
        ((2.0, 2.0, math.pi / 2), math.pi),  # a quarter of the circle
        ((0.0, 4.0, math.pi), 2 * math.pi),  # half of it
        ((7.0, 2.0, math.pi / 2), 5.0 + math.pi),
        ((0.0, 0.0, 0.0), 0.0),
    ],
)
def test_ways_by_hand(goal, expected):
    got = length(jnp.zeros(3), jnp.float32(goal), jnp.float32(2.0))
    assert float(got) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("noise", [0.0, 1e-7, 1e-5])
def test_no_detour_is_made_to_what_lies_straight_ahead_or_behind(noise):
    frame, stray = random_poses(5000, 0), random_poses(5000, 1) * noise / 8
    ahead = stray.at[:, 0].add(jnp.linspace(-6.0, 6.0, 5000))
    got = length(frame, to_world(frame, ahead), jnp.float32(3.9))
    # In float32 the poses are off by 1e-6, for which a car steers some centimetres.
    np.testing.assert_allclose(got, jnp.abs(ahead[:, 0]), atol=0.05)
