"""The refund of the time penalty, by hand; a full episode's penalty is 1."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from helpers.paying import GOAL, MAX_STEPS, events, step, terms
from helpers.scenes import cars

from carpark_mj.config import EnvConfig, RewardConfig
from carpark_mj.mdp.rewards import NEAR, STANDS, reward_terms

ON_A_LINE = [(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (12.0, 0.0, 0.0)]
REWARD = RewardConfig(time=1.0, extra={"yielding": 1.0})


def refund(speed, pose=ON_A_LINE, happened=None, reward=REWARD):
    """Refunds of a step, as shares of its time penalty."""
    motion = cars(pose, speed=speed)
    got = terms(reward, motion, motion, GOAL, happened)
    return got["yielding"] * MAX_STEPS / reward.time


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        ((0.0, 1.0, 0.0), (1, 0, 1)),
        ((0.0, 0.0, -1.0), (0, 1, 0)),  # the first is 12 m from the one that reverses
        ((0.0, 0.0, 0.0), (0, 0, 0)),  # nobody who stands is waited for
        ((1.0, 2.0, 3.0), (0, 0, 0)),
        ((-0.9 * STANDS, 1.1 * STANDS, 0.0), (1, 0, 1)),
    ],
)
def test_who_stands_is_paid_while_another_drives_nearby(speed, expected):
    np.testing.assert_allclose(refund(speed), expected, rtol=1e-6)


def test_nearby_ends_at_its_range():
    for gap, expected in ((NEAR - 0.1, 1.0), (NEAR + 0.1, 0.0)):
        found = refund([0.0, 1.0], [(0.0, 0.0, 0.0), (0.0, gap, 2.0)])
        np.testing.assert_allclose(found, [expected, 0.0], rtol=1e-6)


def test_who_has_just_finished_neither_waits_nor_is_waited_for():
    for name in ("parked", "crashed", "timed_out", "diverged"):
        found = refund([0.0, 1.0, 0.0], happened=events(3, **{name: [1]}))
        np.testing.assert_array_equal(found, 0.0)
        found = refund([0.0, 1.0, 0.0], happened=events(3, **{name: [0]}))
        np.testing.assert_allclose(found, [0, 0, 1], rtol=1e-6)


def test_an_absent_agent_is_not_waited_for():
    config = EnvConfig(num_agents=3, reward=REWARD)
    motion = cars(ON_A_LINE, speed=[0.0, 1.0, 0.0])
    made = step(config, motion, motion)
    before = dataclasses.replace(made.before, active=jnp.array([True, False, True]))
    got = reward_terms(config, dataclasses.replace(made, before=before))
    np.testing.assert_array_equal(got["yielding"], 0.0)


@pytest.mark.parametrize(("weight", "time"), [(1.0, 2.5), (0.3, 2.5), (1.0, 0.0)])
def test_nobody_earns_more_than_the_time_costs(weight, time):
    reward = RewardConfig(time=time, extra={"yielding": weight})
    motion = cars(ON_A_LINE, speed=[0.0, 1.0, 0.0])
    got = terms(reward, motion, motion, GOAL)
    np.testing.assert_allclose(
        got["yielding"] + got["time"],
        -time / MAX_STEPS * np.array([1 - weight, 1, 1 - weight]),
        atol=1e-9,
    )
    assert (got["yielding"] + got["time"] <= 0.0).all()
