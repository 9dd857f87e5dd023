"""Tallies: folded by name, none forgotten; of hand-worked trajectories.

Those of whole episodes are in test_aggregation.py.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.states import parked_at
from helpers.transitions import no_terms, transition

from carpark_mj.config import EnvConfig, MetricsConfig, SimConfig
from carpark_mj.mdp.metrics import fold_tallies, init_stats, update_stats
from carpark_mj.mdp.safety import HORIZON, RANGE
from carpark_mj.types import NO_BAY

DT = SimConfig().ctrl_dt
SAFETY, DRIVING = MetricsConfig(safety=True), MetricsConfig(driving=True)


def tally(measured, states, parked=None, goal=0):
    """Tallies of the first of the cars that pass through some states."""
    count, plan = states[0].size.shape[0], lot([(0.0, 0.0, 0.0)])
    config = EnvConfig(num_agents=count, metrics=measured)
    terms = no_terms(config)

    @jax.jit
    def step(stats, before, after):
        state = {
            "stats": stats,
            "parked_cars": parked_at() if parked is None else parked,
        }
        happened = transition(config, plan, before, after, state, goal)
        return update_stats(config, happened, terms)

    stats = init_stats(config, plan)
    for before, after in itertools.pairwise(states):
        stats = step(stats, before, after)
    return {
        name: float(value[0])
        for name, value in stats.tallies.items()
        if not name.startswith("return_")
    }


def test_a_name_says_how_its_numbers_are_folded():
    names = ("min_a", "peak_a", "last_a", "a")
    tallies = dict.fromkeys(names, jnp.array([1.0, 5.0]))
    folded = fold_tallies(tallies, dict.fromkeys(names, jnp.array([3, 3])))
    assert {name: value.tolist() for name, value in folded.items()} == {
        "min_a": [1.0, 3.0],
        "peak_a": [3.0, 5.0],
        "last_a": [3.0, 3.0],
        "a": [4.0, 8.0],
    }
    assert all(value.dtype == jnp.float32 for value in folded.values())


def test_braking_straight_gives_the_hand_worked_deceleration_and_jerk():
    # 0.6, then 1.2 and 1.2 m/s less per step of 0.2 s: 3, 6, 6 m/s2, then none; the
    # jerk is 3 / 0.2 = 15 at first, then 15, 0 and 6 / 0.2 = 30 m/s3.
    assert DT == 0.2
    speeds = (3.0, 2.4, 1.2, 0.0, 0.0)
    found = tally(SAFETY, [cars([(0, 0, 0.7)], speed=speed) for speed in speeds])
    expected = {
        "acceleration_sum": 3 + 6 + 6,
        "peak_acceleration": 6.0,
        "jerk_sum": 15 + 15 + 0 + 30,
        "peak_jerk": 30.0,
    }
    # float32: 1e-6 m/s over 0.04 s2.
    assert {name: found[name] for name in expected} == pytest.approx(expected, abs=1e-4)


def test_turning_at_constant_speed_is_acceleration_towards_the_centre():
    speed, turn = 3.0, 0.1  # m/s, rad per step
    found = tally(SAFETY, [cars([(0, 0, k * turn)], speed=speed) for k in range(4)])
    # Chords: of the velocity's turn, and of the acceleration's, which turns as well.
    chord = 2 * speed * np.sin(turn / 2) / DT
    assert chord == pytest.approx(speed * turn / DT, rel=1e-3)
    assert found["peak_acceleration"] == pytest.approx(chord, rel=1e-5)
    assert found["acceleration_sum"] == pytest.approx(3 * chord, rel=1e-5)
    assert found["peak_jerk"] == pytest.approx(chord / DT, rel=1e-5)  # at the start
    steady = 2 * chord * np.sin(turn / 2) / DT
    assert found["jerk_sum"] == pytest.approx(chord / DT + 2 * steady, rel=1e-4)
    assert found["min_clearance_wall"] == RANGE
    assert found["min_collision_time_agent"] == HORIZON


def test_the_least_clearance_and_time_are_those_of_the_worst_step():
    # Towards a parked car 4 m long at 20 m: gaps of 8, 6 and 9 m, at 1, 3 and -1 m/s.
    parked = parked_at([(20, 0, 0)], (4.0, 2.0))
    states = [cars([(x, 0, 0)], speed=v) for x, v in ((8, 1), (8, 1), (10, 3), (7, -1))]
    found = tally(SAFETY, states, parked=parked)
    assert found["min_clearance_parked_car"] == pytest.approx(6.0, abs=1e-5)
    assert found["min_collision_time_parked_car"] == pytest.approx(2.0, abs=1e-5)
    absent = parked_at([(20, 0, 0)], (4.0, 2.0), present=False)
    found = tally(SAFETY, states, parked=absent)
    assert found["min_clearance_parked_car"] == RANGE
    assert found["min_collision_time_parked_car"] == HORIZON


def test_driving_is_summed_up_as_by_hand():
    states = [
        cars([(10.0, 0, 0)]),
        cars([(9.0, 0, 0)], speed=-1.5, steering=0.1, yaw_rate=-0.2),
        cars([(9.0, 0, 0)], speed=0.5, steering=-0.1, yaw_rate=0.3),
        cars([(8.5, 0, 0)], speed=0.25, steering=-0.1),
    ]
    parked = parked_at([(9, 3, 0), (9, 1, 0)], present=[True, False])
    found = tally(DRIVING, states, parked=parked)
    assert found == pytest.approx(
        {
            "speed_sum": 2.25,
            "yaw_rate_sum": 0.5,
            "steering_rate_sum": (0.1 + 0.2) / DT,
            "goal_steps": 3.0,
            "towards_goal_steps": 2.0,  # the second step stays where it was
            "nearest_car_sum": 3.0 + 3.0 + np.hypot(0.5, 3.0),
            "nearest_car_steps": 3.0,
        }
    )


def test_steps_without_goal_or_other_car_do_not_count():
    states = [cars([(5.0, 0, 0)]), cars([(4.0, 0, 0)])]
    found = tally(DRIVING, states, goal=NO_BAY)
    for name in ("goal_steps", "towards_goal_steps", "nearest_car_steps"):
        assert found[name] == 0.0
    assert found["nearest_car_sum"] == 0.0  # not inf


def test_the_nearest_car_may_be_another_agent():
    states = [cars([(0, 0, 0), (3.0, 4.0, 0)])] * 2
    found = tally(DRIVING, states, parked=parked_at([(6.0, 0.0, 0.0)]))
    assert found["nearest_car_sum"] == pytest.approx(5.0)
