"""Tallies of hand-worked trajectories, and of whole episodes in an environment."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.clearance import RANGE
from carpark_mj.config import EnvConfig, EpisodeConfig, MetricsConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.tallies import KINDS, first_tallies, fold_tallies, measure
from scenes import SlidePhysics, cars, lot, stacked

DT = 0.2  # s
ALL = MetricsConfig(driving=True, safety=True)
PLAN = lot([(0, 0, 0)])
NOTHING = jnp.zeros((0, 3)), jnp.zeros((0, 2)), jnp.zeros(0, bool)


def tally(config, states, goal=(0.0, 0.0, 0.0), parked=NOTHING, **more):
    """Tallies of the first of the cars that pass through some states."""
    count = states[0].size.shape[0]
    goal = jnp.broadcast_to(jnp.asarray(goal, jnp.float32), (count, 3))
    tallies = first_tallies(config, count)
    for before, after in itertools.pairwise(states):
        step = measure(config, DT, PLAN, tallies, before, after, goal, *parked, **more)
        tallies = fold_tallies(tallies, step)
    return {name: float(value[0]) for name, value in tallies.items()}


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
    speeds = (3.0, 2.4, 1.2, 0.0, 0.0)
    found = tally(ALL, [cars([(0, 0, 0.7)], speed=speed) for speed in speeds])
    expected = {
        "acceleration_sum": 3 + 6 + 6,
        "peak_acceleration": 6.0,
        "jerk_sum": 15 + 15 + 0 + 30,
        "peak_jerk": 30.0,
    }
    # float32: 1e-6 m/s over 0.04 s2.
    assert {name: found[name] for name in expected} == pytest.approx(expected, abs=1e-4)


def test_turning_at_constant_speed_is_acceleration_towards_the_centre():
    speed, yaw_rate = 3.0, 0.5
    states = [cars([(0, 0, k * yaw_rate * DT)], speed=speed) for k in range(4)]
    found = tally(ALL, states)
    # The chord of the velocity's turn, a little short of v times the yaw rate.
    chord = 2 * speed * np.sin(yaw_rate * DT / 2) / DT
    assert chord == pytest.approx(speed * yaw_rate, rel=1e-3)
    assert found["peak_acceleration"] == pytest.approx(chord, rel=1e-5)
    assert found["acceleration_sum"] == pytest.approx(3 * chord, rel=1e-5)
    # Its direction turns with the car: the same chord once more.
    assert found["peak_jerk"] == pytest.approx(chord / DT, rel=1e-5)  # at the start
    steady = 2 * chord * np.sin(yaw_rate * DT / 2) / DT
    assert found["jerk_sum"] == pytest.approx(chord / DT + 2 * steady, rel=1e-4)


def test_driving_is_summed_up_as_by_hand():
    states = [
        cars([(10.0, 0, 0)]),
        cars([(9.0, 0, 0)], speed=-1.5, steering=0.1, yaw_rate=-0.2),
        cars([(9.0, 0, 0)], speed=0.5, steering=-0.1, yaw_rate=0.3),
        cars([(8.5, 0, 0)], speed=0.25, steering=-0.1),
    ]
    parked = jnp.array([[9.0, 3.0, 0.0], [9.0, 1.0, 0.0]]), jnp.full((2, 2), 2.0)
    mask = jnp.array([True, False])
    found = tally(MetricsConfig(driving=True), states, parked=(*parked, mask))
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
    found = tally(MetricsConfig(driving=True), states, has_goal=jnp.array([False]))
    for name in ("goal_steps", "towards_goal_steps", "nearest_car_steps"):
        assert found[name] == 0.0
    assert found["nearest_car_sum"] == 0.0  # not inf


def test_the_nearest_car_may_be_another_agent():
    states = [cars([(0, 0, 0), (3.0, 4.0, 0)])] * 2
    parked = jnp.array([[6.0, 0.0, 0.0]]), jnp.full((1, 2), 2.0), jnp.ones(1, bool)
    found = tally(MetricsConfig(driving=True), states, parked=parked)
    assert found["nearest_car_sum"] == pytest.approx(5.0)


@pytest.fixture(scope="module")
def runs():
    """The same random drive with everything measured and with nothing."""
    actions = jax.random.uniform(jax.random.key(1), (80, 4, 3, 2), minval=-1.0)
    found = []
    for config in (ALL, MetricsConfig()):
        env = ParkingEnv(
            EnvConfig(
                num_agents=3,
                num_parked_cars=25,
                episode=EpisodeConfig(max_steps=25),
                metrics=config,
            ),
            SlidePhysics(),
        )
        state, _ = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 4))
        step = jax.jit(jax.vmap(env.step))
        timesteps, tallies = [], []
        for action in actions:
            state, timestep = step(state, action)
            timesteps.append(jax.device_get(timestep))
            tallies.append(jax.device_get(state.stats.tallies))
        found.append((stacked(timesteps), stacked(tallies)))
    return found


def test_measuring_changes_nothing_else(runs):
    (measured, _), (plain, tallies) = runs
    assert tallies == {}
    extra = measured.metrics.keys() - plain.metrics.keys()
    assert not plain.metrics.keys() - measured.metrics.keys()
    assert len(extra) == len(first_tallies(ALL, 1)) - 2
    assert not any(name.startswith("last_") for name in extra)
    kept = {name: measured.metrics[name] for name in plain.metrics}
    measured = dataclasses.replace(measured, metrics=kept)
    jax.tree.map(np.testing.assert_array_equal, measured, plain)


def test_a_crash_is_a_clearance_of_zero_to_what_was_hit_and_nothing_else_is(runs):
    timesteps, _ = runs[0]
    events = timesteps.events
    done = timesteps.terminated | timesteps.truncated
    for kind in KINDS:
        zero = timesteps.metrics[f"min_clearance_{kind}"] == 0.0
        hit = getattr(events, f"hit_{kind}")
        np.testing.assert_array_equal(zero[done], hit[done], err_msg=kind)
    assert 10 < events.crashed.sum() < done.sum()


def test_tallies_start_anew_with_every_episode(runs):
    timesteps, tallies = runs[0]
    done = timesteps.terminated | timesteps.truncated
    first = first_tallies(ALL, 1)
    assert first["min_clearance_wall"] == RANGE
    for name, value in first.items():
        np.testing.assert_array_equal(tallies[name][done], value[0], err_msg=name)
    np.testing.assert_array_equal(
        timesteps.metrics["goal_steps"], timesteps.metrics["length"]
    )
    speed = np.abs(timesteps.vehicle.velocity_b[..., 0])
    total = np.zeros(done.shape[1:])
    for k in range(len(done)):
        total = total + speed[k]
        np.testing.assert_allclose(timesteps.metrics["speed_sum"][k], total, rtol=1e-5)
        total = np.where(done[k], 0.0, total)
