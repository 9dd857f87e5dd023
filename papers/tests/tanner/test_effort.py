"""Effort: steering change and speed of a step as shares of the most there are."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers.scenes import cars, lot
from helpers.states import HandPhysics, hand_cars
from helpers.transitions import no_events, transition

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.progress import Effort, effort
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_papers.tanner.grid import FINE, GridPhysics, GridState

LOT = lot([(0.0, 0.0, 0.0)])


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
        LOT,
        before,
        after,
        {"physics": HandPhysics(hand_cars(before))},
        target_pose=jnp.zeros((count, 3)),
        events=no_events(count),
    )


def test_effort_on_the_grid_is_turn_and_level_over_the_most_there_are():
    still, turn, level = grid_cars([(0, 0)] * 5), [-3, -1, 0, 2, 3], [4, 2, 0, -1, -2]
    after = grid_cars([(0, 0)] * 5, level, turn)
    config = EnvConfig(physics="grid", num_agents=5)
    got = effort(config, step(config, still, after))
    np.testing.assert_allclose(got.turn, [1, 1 / 3, 0, 2 / 3, 1], atol=1e-6)
    np.testing.assert_allclose(got.speed, [1, 0.5, 0, 0.25, 0.5], atol=1e-6)


def test_a_car_that_obeys_at_once_turns_from_lock_to_lock_at_most():
    lock = float(hand_cars(cars([(0.0, 0.0, 0.0)])).max_steering[0])
    poses = [(0.0, 0.0, 0.0)] * 3
    before = cars(poses, steering=[lock, lock, lock])
    after = cars(poses, steering=[lock, 0.0, -lock])
    config = EnvConfig(physics="highway", vehicle="highway", num_agents=3)
    got = effort(config, step(config, before, after))
    np.testing.assert_allclose(got.turn, [0.0, 0.5, 1.0], atol=1e-6)


def test_efforts_have_one_number_an_agent():
    one = grid_cars([(0, 0)] * 4)
    for physics in ("mjx", "grid"):
        config = EnvConfig(physics=physics, num_agents=4)
        got = effort(config, step(config, one, one))
        assert isinstance(got, Effort)
        assert got.turn.shape == got.speed.shape == (4,)
        assert got.turn.dtype == got.speed.dtype == jnp.float32
