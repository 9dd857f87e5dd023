"""Reeds and Shepp's shortest ways: against OMPL, by hand, and in any frame."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.geometry import reeds_shepp_length, to_world

length = jax.jit(reeds_shepp_length)
RADIUS = 1.7  # m, of the table
# x, y, yaw and distance from the origin by OMPL 2.0.1's ReedsSheppStateSpace(1.7); on
# 20,000 random poses of the same kind the largest difference was 1.2e-5 m.
OMPL = np.array(
    [
        (-0.0314, 0.3948, -0.5016, 1.71268),
        (0.0185, -0.1469, 0.3086, 1.07975),
        (-0.0746, 0.0749, 0.0007, 0.93726),
        (-0.0475, -0.0304, 1.5740, 2.67580),
        (-0.0624, -0.0700, 0.0044, 0.91318),
        (-0.0221, 0.0895, 0.0074, 1.07691),
        (0.1494, 0.6758, -1.9238, 3.27046),
        (1.5779, 0.0543, -0.8005, 2.26721),
        (0.5561, 0.1203, 1.1359, 1.93103),
        (1.4754, -0.0570, -1.7957, 3.05269),
        (-1.4558, 0.4852, 2.7855, 4.73535),
        (-1.0787, -0.3388, 2.0235, 3.43995),
        (-0.9940, -2.7552, 2.0319, 3.79060),
        (4.3737, -3.3346, -1.5279, 5.77117),
        (2.5474, -2.3742, 1.4696, 5.51008),
        (-0.4299, -3.8421, -0.9674, 5.56636),
        (3.2236, 3.1750, 2.3280, 5.74098),
        (3.2455, 2.0572, -2.5093, 5.74093),
        (-4.7918, -7.7441, 3.0553, 10.97334),
        (2.6613, -8.6892, 0.8860, 10.95361),
        (21.1410, 13.2332, -0.1824, 25.11326),
        (-6.6997, -15.6812, -2.8663, 18.77020),
        (-9.1264, 7.6592, 0.0243, 12.14787),
        (-16.4449, 17.6599, -0.4686, 24.30432),
    ]
)


def random_poses(count, seed=0):
    rng = np.random.default_rng(seed)
    return jnp.float32(rng.uniform((-8, -8, -3.14), (8, 8, 3.14), (count, 3)))


def test_lengths_are_those_of_ompl():
    goal = jnp.float32(OMPL[:, :3])
    got = length(jnp.zeros_like(goal), goal, jnp.float32(RADIUS))
    np.testing.assert_allclose(got, OMPL[:, 3], atol=5e-5)  # rounding of the table


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
