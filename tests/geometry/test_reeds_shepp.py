"""Reeds and Shepp's shortest ways: against OMPL, by hand, and in any frame."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.geometry import reeds_shepp_length, to_world

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


def test_the_way_back_is_as_long_and_frames_do_not_matter():
    a, b, frame = (random_poses(500, seed) for seed in range(3))
    radius = jnp.linspace(1.0, 6.0, 500)
    there = length(a, b, radius)
    np.testing.assert_allclose(length(b, a, radius), there, rtol=1e-4, atol=1e-4)
    moved = length(to_world(frame, a), to_world(frame, b), radius)
    np.testing.assert_allclose(moved, there, rtol=1e-4, atol=1e-3)
    straight = np.linalg.norm(a[:, :2] - b[:, :2], axis=1)
    assert (there > straight - 1e-4).all()


@pytest.mark.parametrize("noise", [0.0, 1e-7, 1e-5])
def test_no_detour_is_made_to_what_lies_straight_ahead_or_behind(noise):
    frame, stray = random_poses(5000, 0), random_poses(5000, 1) * noise / 8
    ahead = stray.at[:, 0].add(jnp.linspace(-6.0, 6.0, 5000))
    got = length(frame, to_world(frame, ahead), jnp.float32(3.9))
    # In float32 the poses are off by 1e-6, for which a car steers some centimetres.
    np.testing.assert_allclose(got, jnp.abs(ahead[:, 0]), atol=0.05)


def test_a_detour_is_no_shorter_and_a_tighter_circle_no_longer():
    a, b, c = (random_poses(2000, seed) for seed in range(3))
    direct = length(a, c, jnp.float32(3.0))
    detour = length(a, b, jnp.float32(3.0)) + length(b, c, jnp.float32(3.0))
    assert (direct <= detour + 1e-4).all()
    assert (length(a, c, jnp.float32(2.0)) <= direct + 1e-4).all()
