"""The unrolled equations of motion, one substep at a time, in float64."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from carpark_mj.config import RandomizationConfig, SimConfig
from carpark_mj.physics.coordinates import (
    CarDynamics,
    CarIndex,
    init_tyres,
    pack_coordinates,
    unpack_coordinates,
)
from carpark_mj.physics.forces import CarForces, generalized_forces
from carpark_mj.physics.mjx_step import MjxStep, with_masses
from carpark_mj.physics.newton_euler import advance, mass_properties
from carpark_mj.spawning.fleet import randomize
from carpark_mj.vehicle import COMPACT, PRESETS, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import init_actuators
from carpark_mj.vehicle.mjcf import car_model

DT = 0.01
GRAVITY = (0.7, -1.1, -9.6)
LOADED = RandomizationConfig(
    mass=(0.7, 1.4), cg_x=(0.9, 1.1), cg_height=(0.8, 1.3), friction=(0.5, 1.2)
)
INDEX = CarIndex(car_model(COMPACT, DT, GRAVITY))


@pytest.fixture(autouse=True)
def _float64():
    with jax.enable_x64(True):
        yield


def harsh_state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A tumbling car within the limit of its servos: `qpos` (13,) and `qvel` (12,)."""
    qpos, qvel = rng.normal(size=13), rng.normal(0, 3, 12)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[INDEX.steer_qpos] = rng.uniform(-0.6, 0.6, 2)
    qvel[INDEX.steer_dof] = rng.uniform(-0.5, 0.5, 2)
    qvel[INDEX.spin_dof] = rng.uniform(-60, 60, 4)
    return qpos, qvel


def harsh_forces(rng: np.random.Generator) -> CarForces:

    def draw(size: float, count: int) -> tuple:
        return tuple(jnp.array(x) for x in rng.normal(0, size, count))

    return CarForces(
        force_w=draw(2e4, 3),
        moment_b=draw(1e4, 3),
        aligning=draw(200, 4),
        spin=draw(800, 4),
        load=draw(1, 4),
    )


def targets_near(qpos: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Steering targets (2,) [rad] that the servos reach within their torque."""
    return qpos[INDEX.steer_qpos] + rng.uniform(-0.015, 0.015, 2)


def in_c(vehicle: Vehicle, qpos, qvel, forces: CarForces, targets, gravity=GRAVITY):
    """`qpos` and `qvel` after one step of C MuJoCo."""
    model = car_model(COMPACT, DT, gravity)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos"):
        getattr(model, name)[:] = getattr(vehicle, name)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, targets
    data.qfrc_applied[:] = generalized_forces(INDEX, forces)
    mujoco.mj_step(model, data)
    return data.qpos, data.qvel


def unrolled(vehicle: Vehicle, qpos, qvel, forces, targets, gravity=GRAVITY, dt=DT):
    at = unpack_coordinates(INDEX, jnp.array(qpos), jnp.array(qvel))
    masses = mass_properties(vehicle)
    after = advance(masses, at, forces, tuple(targets), gravity, dt)
    return pack_coordinates(INDEX, after)


@pytest.mark.parametrize("name", PRESETS)
def test_a_harsh_substep_of_a_randomized_car_is_that_of_c_mujoco(name):
    rng = np.random.default_rng(len(name))
    nominal = make_vehicle(PRESETS[name])
    step = jax.jit(unrolled)
    for trial in range(30):
        vehicle = randomize(LOADED, nominal, jax.random.key(trial))
        (qpos, qvel), forces = harsh_state(rng), harsh_forces(rng)
        targets = targets_near(qpos, rng)
        after = step(vehicle, qpos, qvel, forces, targets)
        expected = in_c(vehicle, qpos, qvel, forces, targets)
        # Velocities up to 88; measured 9e-13.
        assert after[0] == pytest.approx(expected[0], abs=1e-11)
        assert after[1] == pytest.approx(expected[1], abs=1e-11)


def test_a_servo_at_its_limit_is_integrated_as_mjx_does():
    """MJX stays implicit in the damping of a clipped servo, C MuJoCo does not."""
    vehicle = make_vehicle(COMPACT)
    step = MjxStep(car_model(COMPACT, DT, GRAVITY), SimConfig())
    model = with_masses(step.model, vehicle)
    judge = jax.jit(partial(step.integrate, model))
    qpos, qvel = harsh_state(np.random.default_rng(3))
    forces = harsh_forces(np.random.default_rng(4))
    rest = init_tyres(), init_actuators(vehicle)
    car = CarDynamics(jnp.array(qpos), jnp.array(qvel), *rest)
    for targets in ([1.5, -1.5], [-1.5, 1.5]):  # 1 rad asks for 40 times the limit
        after = unrolled(vehicle, qpos, qvel, forces, targets)
        qfrc = generalized_forces(INDEX, forces)
        expected = judge(car, qfrc, jnp.array(targets))
        assert after[0] == pytest.approx(np.asarray(expected.qpos), abs=1e-11)
        assert after[1] == pytest.approx(np.asarray(expected.qvel), abs=1e-11)
