"""Rewards, returns and effort of the study."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.paying import GOAL, LIMITS, MAX_STEPS, terms
from helpers.scenes import cars, lot
from helpers.states import HandPhysics, hand_cars
from helpers.transitions import no_events, transition

from carpark_mj.config import REWARDS, WORLD_UNIT, EnvConfig, RewardConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.progress import effort
from carpark_mj.mdp.rewards import TERMS
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_papers.tanner.environments import TANNER_QLEARNING
from carpark_papers.tanner.grid import FINE, GridPhysics, GridState

STEERING_CHANGE = 0.2 * LIMITS["steering_rate"]  # rad in 0.2 s


def driven(distances, speed=1.0, steering=0.0):
    """Steps along the bay's axis with the given distances to the goal."""
    x = GOAL[0] - np.asarray(distances, np.float64)
    poses = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    steering = np.broadcast_to(steering, x.shape)
    before = cars(poses[:-1], speed, steering[:-1])
    return terms(REWARDS["tanner"], before, cars(poses[1:], speed, steering[1:]), GOAL)


def test_an_episode_of_tanners_sums_to_his_numbers_wherever_it_goes():
    got = driven(np.linspace(30.0, 10.0, MAX_STEPS + 1))
    total = {name: term.sum() for name, term in got.items()}
    expected = {"time": -0.2, "approach": 0.15, "progress": 0.0, "reverse": 0.0}
    for name, value in expected.items():
        assert total[name] == pytest.approx(value, abs=1e-6), name  # float32
    assert sum(total.values()) == pytest.approx(-0.05, abs=1e-6)
    for distances in (np.full(MAX_STEPS + 1, 10.0), np.linspace(10, 30, MAX_STEPS + 1)):
        got = driven(distances)
        assert got["approach"].sum() == pytest.approx(-0.15, abs=1e-6)  # float32
        assert got["time"].sum() == pytest.approx(-0.2, abs=1e-6)


def test_tanners_episode_in_reverse_or_steering_costs_its_sum():
    got = driven(np.linspace(30.0, 10.0, MAX_STEPS + 1), speed=-1.0)
    assert got["reverse"].sum() == pytest.approx(-0.1, abs=1e-6)  # float32
    for still in (0.0, -1e-6):  # on tyres a car that its brakes hold is never at 0
        got = driven(np.linspace(30.0, 10.0, MAX_STEPS + 1), speed=still)
        assert got["reverse"].sum() == 0.0
    steering = STEERING_CHANGE * (np.arange(MAX_STEPS + 1) % 2)
    got = driven(np.linspace(30.0, 10.0, MAX_STEPS + 1), steering=steering)
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


WEIGHTS = dataclasses.replace(
    TANNER_QLEARNING.reward,
    extra=TANNER_QLEARNING.reward.extra | {"smoothness": 0.6, "reverse": 0.7},
)


@pytest.fixture(scope="module")
def grid():
    env = ParkingEnv(dataclasses.replace(TANNER_QLEARNING, reward=WEIGHTS))
    return env, env.reset(jax.random.key(0))[0], jax.jit(env.step)


def drive(grid, point, choices, step=0):
    """Drives nose up from a point towards the bay at (0, 32); the last time step."""
    env, state, advance = grid
    bays = np.asarray(state.layout.bay_pose[:, :2]) / WORLD_UNIT
    goal = np.abs(bays - [0, 32]).sum(axis=1).argmin()
    physics = dataclasses.replace(
        state.physics,
        point=jnp.array([point], jnp.int32),
        heading=jnp.zeros(1, jnp.int32),
        level=jnp.zeros(1, jnp.int32),
    )
    state = dataclasses.replace(
        state,
        physics=physics,
        motion=env.physics.read(physics),
        goal=jnp.array([goal], "int32"),
        step=jnp.array([step], jnp.int32),
    )
    for k, choice in enumerate(choices):
        state, timestep = advance(state, jnp.array([choice]))
        assert bool(timestep.events.done[0]) is (k == len(choices) - 1)
    return timestep.events, {
        name.removeprefix("return_"): float(value[0])
        for name, value in timestep.metrics.items()
        if name.startswith("return_")
    }


def expected(**totals):
    """All terms, 0 where not given."""
    return pytest.approx(
        dict.fromkeys((*TERMS, *WEIGHTS.extra), 0.0) | totals, abs=1e-6
    )


def test_an_episode_that_parks(grid):
    # Acceleration and turn, each -1, 0 or 1: index 0, 1 or 2.
    choices = [
        (2, 1),  # to (0, 28): nearer
        (0, 2),  # stops, and cannot turn: not nearer
        (0, 1),  # back to (0, 27): farther, in reverse
        (2, 0),  # stops, cannot turn: not nearer
        (2, 2),  # turns right by 45 deg, to (1, 28): nearer
        (1, 0),  # turns back, to (1, 29): nearer
        (1, 1),  # (1, 30): nearer
        (1, 0),  # turns left by 45 deg, to (0, 31): nearer, and parked at level 1 of 1
    ]
    events, totals = drive(grid, (0, 27), choices)
    assert events.parked.all()
    assert totals == expected(
        park=10.0,
        time=-0.5 * 8 / 85,
        approach=(5 - 3) / 85,
        smoothness=-0.6 * 3 / 85,
        reverse=-0.7 / 85,
    )


def test_an_episode_that_crashes(grid):
    # Beside the bay's mouth at 45 deg: the block at (32, 32) reaches down to 27.5.
    events, totals = drive(grid, (21, 24), [(2, 2), (1, 1), (1, 1)])
    assert events.crashed.all()
    assert events.hit_wall.all()
    assert totals == expected(
        crash=-10.0,
        time=-0.5 * 3 / 85,
        # 21^2 + 8^2 = 505, then 22^2 + 7^2 = 533, 565 and 601: never nearer.
        approach=-3 / 85,
        smoothness=-0.6 / 85,
    )


def test_an_episode_whose_time_is_up(grid):
    # Two steps ahead, and one to stop.
    events, totals = drive(grid, (0, 0), [(2, 1), (1, 1), (0, 1)], step=82)
    assert events.timed_out.all()
    assert totals == expected(time=-0.5 * 3 / 85, approach=(2 - 1) / 85)


def grid_cars(points, level=0, turn=0):
    """The grid's cars (n,) at points, as its physics shows them."""
    physics = GridPhysics(FINE, EnvConfig().sim)
    count = len(points)
    vehicle = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (count, *x.shape)), make_vehicle(COMPACT)
    )
    zero = jnp.zeros(count, jnp.int32)
    return physics.read(
        GridState(
            point=jnp.asarray(points, jnp.int32),
            level=zero + jnp.asarray(level, jnp.int32),
            heading=zero,
            turn=zero + jnp.asarray(turn, jnp.int32),
            vehicle=vehicle,
        )
    )


def step(config, before, after):
    count = before.yaw_rate.shape[0]
    return transition(
        config,
        lot([(0.0, 0.0, 0.0)]),
        before,
        after,
        {"physics": HandPhysics(hand_cars(before))},
        target_pose=jnp.zeros((count, 3)),
        events=no_events(count),
    )


def test_effort_is_turn_and_level_over_the_most_there_are():
    still, turn, level = grid_cars([(0, 0)] * 5), [-3, -1, 0, 2, 3], [4, 2, 0, -1, -2]
    after = grid_cars([(0, 0)] * 5, level, turn)
    config = EnvConfig(physics="grid", num_agents=5)
    turn, speed = effort(config, step(config, still, after))
    np.testing.assert_allclose(turn, [1, 1 / 3, 0, 2 / 3, 1], atol=1e-6)
    np.testing.assert_allclose(speed, [1, 0.5, 0, 0.25, 0.5], atol=1e-6)
    lock = float(hand_cars(cars([(0.0, 0.0, 0.0)])).max_steering[0])
    poses = [(0.0, 0.0, 0.0)] * 3
    before = cars(poses, steering=[lock, lock, lock])
    after = cars(poses, steering=[lock, 0.0, -lock])
    config = EnvConfig(physics="highway", vehicle="highway", num_agents=3)
    turn, _ = effort(config, step(config, before, after))
    np.testing.assert_allclose(turn, [0.0, 0.5, 1.0], atol=1e-6)
