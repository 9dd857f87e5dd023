"""Cars in C MuJoCo with the driver and the tyres of `carpark_mj`: the oracle of MJX."""

import functools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

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
from carpark_mj.physics.mjx_step import axle_friction, contact_car_model
from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import actuate, init_actuators, roll_freely
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import VehicleParameters


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
        self._tyres = init_tyres(jnp.result_type(float))
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
            poses.append(self.pose)
        return np.array(poses)

    @property
    def pose(self) -> np.ndarray:
        """Pose (3,) of the footprint's centre [m, m, rad]."""
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.data.qpos[3:7])
        yaw = math.atan2(rotation[3], rotation[0])
        x, y = self.data.qpos[:2]
        x, y = x + self._offset * math.cos(yaw), y + self._offset * math.sin(yaw)
        return np.array([x, y, yaw])


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
            qfrc, targets, tyres, actuators = substep_forces(
                index, vehicle, car, controls, dt
            )
            return qfrc, targets, None, tyres, actuators
        at, (steer, pedal) = unpack_coordinates(index, car.qpos, car.qvel), controls
        ahead = dot(column(at.rotation, 0), at.velocity)
        rolled = vehicle.wheel_radius * (jnp.stack(at.spin) @ vehicle.drive_share)
        actuators, angles, brake = actuate(
            vehicle, car.actuators, (steer, pedal), ahead, rolled, dt
        )
        torque = actuators.drive * vehicle.drive_share
        qfrc = jnp.zeros_like(car.qvel).at[index.spin_dof].set(torque)
        friction = axle_friction(vehicle, brake * vehicle.brake_share)
        return qfrc, jnp.stack(angles), friction, car.tyres, actuators

    return forces
