"""The study's reward by hand, over whole episodes."""

import numpy as np
import pytest
from helpers.paying import GOAL, MAX_STEPS, STEERING_CHANGE, terms
from helpers.scenes import cars

from carpark_mj.config import REWARDS, RewardConfig

TANNER = REWARDS["tanner"]


def drive(distances, speed=1.0, steering=0.0):
    """Steps along the bay's axis with the given distances to the goal."""
    x = GOAL[0] - np.asarray(distances, np.float64)
    poses = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    steering = np.broadcast_to(steering, x.shape)
    before = cars(poses[:-1], speed, steering[:-1])
    return terms(TANNER, before, cars(poses[1:], speed, steering[1:]), GOAL)


def test_an_episode_of_tanners_that_always_approaches_sums_to_his_numbers():
    got = drive(np.linspace(30.0, 10.0, MAX_STEPS + 1))
    total = {name: term.sum() for name, term in got.items()}
    expected = {"time": -0.2, "approach": 0.15, "progress": 0.0, "reverse": 0.0}
    for name, value in expected.items():
        assert total[name] == pytest.approx(value, abs=1e-6), name  # float32
    assert sum(total.values()) == pytest.approx(-0.05, abs=1e-6)


def test_an_episode_of_tanners_that_stands_still_is_as_bad_as_one_that_leaves():
    for distances in (np.full(MAX_STEPS + 1, 10.0), np.linspace(10, 30, MAX_STEPS + 1)):
        got = drive(distances)
        assert got["approach"].sum() == pytest.approx(-0.15, abs=1e-6)  # float32
        assert got["time"].sum() == pytest.approx(-0.2, abs=1e-6)


def test_an_episode_of_tanners_in_reverse_costs_the_whole_reverse_sum():
    got = drive(np.linspace(30.0, 10.0, MAX_STEPS + 1), speed=-1.0)
    assert got["reverse"].sum() == pytest.approx(-0.1, abs=1e-6)  # float32
    for still in (0.0, -1e-6):  # on tyres a car that its brakes hold is never at 0
        got = drive(np.linspace(30.0, 10.0, MAX_STEPS + 1), speed=still)
        assert got["reverse"].sum() == 0.0


def test_an_episode_of_tanners_with_all_the_steering_there_is_costs_its_sum():
    steering = STEERING_CHANGE * (np.arange(MAX_STEPS + 1) % 2)
    got = drive(np.linspace(30.0, 10.0, MAX_STEPS + 1), steering=steering)
    assert got["smoothness"].sum() == pytest.approx(-0.05, abs=1e-6)  # float32


def test_smoothness_can_count_times_the_speed():
    steering = STEERING_CHANGE * (np.arange(MAX_STEPS + 1) % 2)
    poses = [(0.0, 0.0, 0.0)] * (MAX_STEPS + 1)
    speed = np.linspace(-2.0, 3.0, MAX_STEPS)
    before = cars(poses[:-1], 0.0, steering[:-1])
    after = cars(poses[1:], speed, steering[1:])
    plain = RewardConfig(extra={"smoothness": 0.05})
    got = terms(plain, before, after, GOAL)["smoothness"]
    assert got.sum() == pytest.approx(-0.05, abs=1e-6)
    by_speed = RewardConfig(extra={"smoothness": 0.05, "smoothness.by_speed": 1.0})
    got = terms(by_speed, before, after, GOAL)["smoothness"]
    expected = -0.05 / MAX_STEPS * np.abs(speed) / 3.0
    np.testing.assert_allclose(got, expected, atol=1e-9)
