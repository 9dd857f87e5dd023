"""The controller that drives a car along a path."""

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.planning.paths import CREEP, hold_distances
from carpark_mj.vehicle import COMPACT, make_vehicle


def test_a_car_whose_pedal_is_released_rolls_as_far_as_is_planned():
    speed = np.array([0.05, 0.1, 0.2, 0.25, 0.295, 0.2999])  # below `CREEP`
    assert speed.max() < CREEP
    physics = BicyclePhysics(SimConfig())
    cars = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (len(speed), *x.shape)), make_vehicle(COMPACT)
    )
    state = physics.init(jnp.zeros((len(speed), 3)), cars)
    state = physics.set_speed(state, jnp.array(speed, jnp.float32))
    step = jax.jit(physics.step)
    for _ in range(5):
        state = step(state, jnp.zeros((len(speed), 2)))
    motion = physics.read(state)
    assert np.abs(motion.velocity_b).max() == 0.0
    planned = np.interp(speed, *hold_distances())
    np.testing.assert_allclose(motion.pose_w[:, 0], planned, atol=2e-3)
