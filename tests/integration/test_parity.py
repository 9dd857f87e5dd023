"""The batched physics against plain C MuJoCo with the same tyre code."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.oracle import CCar

from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import COMPACT, VehicleParameters, make_vehicle

SIM = SimConfig(sim_dt=0.01, ctrl_dt=0.01, trace_dt=0.01)
START = (1.0, -2.0, 0.4)
# One second: pull away turning left, steer over, brake hard, hold.
CONTROLS = np.repeat(
    [[1.0, 1.0], [-0.6, 0.8], [0.4, -1.0], [0.4, 0.0]], [40, 30, 20, 10], axis=0
)
# Differs from the car that MJX compiles in everything that a batch may mix.
VAN = dataclasses.replace(
    COMPACT,
    wheelbase=3.2,
    track_width=1.7,
    width=1.95,
    length=5.2,
    mass=2100.0,
    cg_to_front_axle=1.5,
    cg_height=0.75,
    roll_inertia=1000.0,
    pitch_inertia=4300.0,
    yaw_inertia=4600.0,
    wheel_radius=0.35,
    wheel_mass=28.0,
    wheel_inertia=1.8,
    wheel_tilt_inertia=1.0,
    knuckle_mass=14.0,
    front_drive=0.0,
    ackermann=0.6,
)


@functools.cache
def make_driver(x64: bool):
    """Compiles the drive for MJX, once for all cars of one precision."""
    with jax.enable_x64(x64):
        physics = MjxPhysics(SIM)
        controls = jnp.array(CONTROLS, dtype=jnp.result_type(float))

        def step(state, control):
            state = physics.step(state, control)
            return state, physics.read(state).pose_w

        run = jax.jit(lambda state: jax.lax.scan(step, state, controls)[1])

    def drive(params: VehicleParameters) -> np.ndarray:
        with jax.enable_x64(x64):
            state = physics.init(jnp.array(START), make_vehicle(params))
            return np.asarray(run(state))

    return drive


@pytest.mark.parametrize(
    ("x64", "tolerance"),
    [
        # Metres and radians on a path of 0.6 m. Measured up to 1.2e-6 and 1.1e-15.
        pytest.param(False, 5e-6, id="float32"),
        pytest.param(True, 1e-12, id="float64"),
    ],
)
@pytest.mark.parametrize(
    "params", [pytest.param(COMPACT, id="compact"), pytest.param(VAN, id="van")]
)
def test_a_second_of_driving_agrees_with_c_mujoco(params, x64, tolerance):
    with jax.enable_x64(True):
        expected = CCar(params, START, SIM).drive(CONTROLS)
    poses = make_driver(x64)(params)
    assert poses.dtype == (np.float64 if x64 else np.float32)
    assert np.linalg.norm(expected[-1, :2] - START[:2]) > 0.4  # it did drive
    assert np.abs(poses - expected).max() < tolerance
