"""The shipped driver and tyres, in MJX as in training and in C MuJoCo, its oracle."""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import ArrayLike

from carpark_mj.config import SimConfig
from carpark_mj.physics.coordinates import (
    CarDynamics,
    CarIndex,
    column,
    dot,
    init_tyres,
    unpack_coordinates,
)
from carpark_mj.physics.forces import gravity_vector, substep_forces
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.physics.mjx_step import ContactPhysics, axle_friction, contact_car_model
from carpark_mj.types import Motion
from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import actuate, init_actuators, roll_freely
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import VehicleParameters


class Recording(NamedTuple):
    """What cars (...) did: after each of T control steps."""

    motion: Motion  # (T, ...)
    qpos: jax.Array  # (T, ..., 13)
    qvel: jax.Array  # (T, ..., 12)


@functools.cache
def _program(sim: SimConfig, dtype: Any):
    """The physics, and a compiled drive in the precision that is switched on."""
    del dtype  # a key of the cache
    physics = (ContactPhysics if sim.tyres == "contact" else MjxPhysics)(sim)

    @jax.jit
    def run(state: CarState, controls: jax.Array, release: float, after: int):
        def step(carry: tuple[CarState, jax.Array], now: tuple):
            (state, released), (instant, command) = carry, now
            slow = jnp.abs(physics.read(state).speed) < release
            released = released | (slow & (instant >= after))
            pedal = jnp.where(released, 0.0, command[..., 1])
            state = physics.step(state, jnp.stack([command[..., 0], pedal], -1))
            seen = Recording(physics.read(state), state.qpos, state.qvel)
            return (state, released), seen

        start = state, jnp.zeros(controls.shape[1:-1], bool)
        return jax.lax.scan(step, start, (jnp.arange(len(controls)), controls))[1]

    return physics, run


def drive(
    sim: SimConfig,
    cars: Vehicle,
    controls: np.ndarray,
    speed: ArrayLike = 0.0,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    release: float = 0.0,
    after: int = 0,
) -> Recording:
    """Drives cars (...) by control steps (T, ..., 2) from poses (..., 3) and speeds.

    A pedal is let go for good below the speed `release` [m/s], from a step on.
    """
    dtype = jnp.result_type(float)
    physics, run = _program(sim, dtype)
    pose = np.broadcast_to(pose, (*controls.shape[1:-1], 3))
    state = physics.init(jnp.array(pose, dtype), cars)
    if np.any(speed):
        state = physics.set_speed(state, jnp.array(speed, dtype))
    return jax.device_get(run(state, jnp.array(controls, dtype), release, after))


class CCar:
    """A car stepped by `mujoco.mj_step`, whose engine computes in float64.

    Driver and tyres are computed in JAX's default float: construct and step the car
    under `jax.enable_x64(True)` for float64 throughout.
    """

    def __init__(
        self,
        params: VehicleParameters,
        sim: SimConfig,
        pose: Sequence[float] = (0.0, 0.0, 0.0),
        speed: float = 0.0,
        model: mujoco.MjModel | None = None,
    ) -> None:
        """Places a car by its footprint's centre [m, m, rad], rolling ahead [m/s].

        `model` is used in place of the car's own.
        """
        self._sim, self._model = sim, model or car_in_c(params, sim)
        self.vehicle, self.data = make_vehicle(params), mujoco.MjData(self._model)
        self.index, self._offset = _index(sim), params.centre_offset
        x, y, yaw = pose
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        self.data.qpos[:2] = np.array([x, y]) - self._offset * ahead
        self.data.qpos[3:7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        self.data.qvel[:2] = speed * ahead
        self.data.qvel[self.index.spin_dof] = speed / params.wheel_radius
        self._tyres = init_tyres(dtype=jnp.result_type(float))
        self.actuators = init_actuators(self.vehicle)
        if speed:
            self.actuators = roll_freely(self.actuators, jnp.array(speed))
        self._forces = _forces(sim, jnp.result_type(float))

    def step(self, controls: Sequence[float]) -> None:
        """Advances by one `sim_dt` with steer and pedal."""
        data = self.data
        at = jnp.array(data.qpos), jnp.array(data.qvel), self._tyres, self.actuators
        asked = jnp.array(controls, jnp.result_type(float))
        acting = self._forces(self.vehicle, CarDynamics(*at), asked)
        data.qfrc_applied, data.ctrl, friction, self._tyres, self.actuators = acting
        if friction is not None:
            self._model.dof_frictionloss[self.index.spin_dof] = friction
            data.qacc_warmstart[:] = 0.0  # as in MJX, which carries no warm start
        mujoco.mj_step(self._model, data)

    def drive(self, controls: np.ndarray) -> np.ndarray:
        """Poses (T, 3) after each of the control steps (T, 2)."""
        poses: list[np.ndarray] = []
        for control in controls:
            for _ in range(self._sim.num_substeps):
                self.step(control)
            x, y, yaw, *_ = self.motion
            ahead = self._offset * np.array([math.cos(yaw), math.sin(yaw), 0.0])
            poses.append(np.array([x, y, yaw]) + ahead)
        return np.array(poses)

    @property
    def motion(self) -> tuple[float, ...]:
        """x, y [m], yaw [rad], speed [m/s] and yaw rate [rad/s] of the rear axle."""
        x, y, _, w, i, j, k, *_ = self.data.qpos.tolist()
        v_x, v_y, _, _, _, rate, *_ = self.data.qvel.tolist()
        yaw = math.atan2(2 * (i * j + w * k), 1 - 2 * (j * j + k * k))
        return x, y, yaw, v_x * math.cos(yaw) + v_y * math.sin(yaw), rate


def car_in_c(params: VehicleParameters, sim: SimConfig) -> mujoco.MjModel:
    """The model of a car alone on its tyres."""
    if sim.tyres == "contact":
        return contact_car_model(params, sim)
    return car_model(params, sim.sim_dt, gravity_vector(sim))


@functools.cache
def _index(sim: SimConfig) -> CarIndex:
    return CarIndex(car_in_c(COMPACT, sim))  # that of any car


@functools.cache
def _forces(sim: SimConfig, dtype: Any):
    """Compiles what acts on a car over a substep.

    Returns `qfrc_applied`, servo targets (2,) [rad], dry friction of the axles (4,) on
    contact wheels [N m], bristles and actuators.
    """
    del dtype  # a key of the cache
    index, dt = _index(sim), sim.sim_dt

    @jax.jit
    def forces(vehicle: Vehicle, car: CarDynamics, controls: jax.Array):
        if sim.tyres == "brush":
            acting = substep_forces(index, vehicle, car, controls, dt)
            return *acting[:2], None, *acting[2:]
        at, pedals = unpack_coordinates(index, car.qpos, car.qvel), tuple(controls)
        ahead = dot(column(at.rotation, 0), at.velocity)
        rolled = vehicle.wheel_radius * (jnp.stack(at.spin) @ vehicle.drive_share)
        actuators, angles, brake = actuate(
            vehicle, car.actuators, pedals, ahead, rolled, dt
        )
        torque = actuators.drive * vehicle.drive_share
        qfrc = jnp.zeros_like(car.qvel).at[index.spin_dof].set(torque)
        friction = axle_friction(vehicle, brake * vehicle.brake_share)
        return qfrc, jnp.stack(angles), friction, car.tyres, actuators

    return forces
