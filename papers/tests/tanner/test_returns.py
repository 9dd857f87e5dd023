"""A hand-worked episode on the grid: what every reward term comes to in all."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import WORLD_UNIT, RewardConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.rewards import TERMS
from carpark_papers.tanner.environments import TANNER_QLEARNING

WEIGHTS = RewardConfig(
    park=10.0,
    crash=10.0,
    time=0.5,
    progress=0.0,
    alignment=0.0,
    closeness=0.0,
    extra={"approach": 1.0, "smoothness": 0.6, "reverse": 0.7},
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
