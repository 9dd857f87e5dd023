"""The oracle of the batched physics: one car in C MuJoCo, with the same tyre code."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.physics.coordinates import CarDynamics, CarIndex, init_tyres
from carpark_mj.physics.forces import gravity_vector, substep_forces
from carpark_mj.vehicle.drive import init_actuators
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.vehicle import make_vehicle


class CCar:
    """A car stepped by `mujoco.mj_step`, whose engine computes in float64.

    The tyres are computed in JAX's default float: construct and step the car under
    `jax.enable_x64(True)` for float64 throughout.
    """

    def __init__(
        self,
        params: VehicleParameters,
        pose: tuple[float, float, float],
        sim: SimConfig,
    ) -> None:
        """Places a car at rest; `pose` is that of its footprint's centre."""
        self.params = params
        self.model = car_model(params, sim.sim_dt, gravity_vector(sim))
        self.data = mujoco.MjData(self.model)
        x, y, yaw = pose
        self.data.qpos[:2] = (
            x - params.centre_offset * np.cos(yaw),
            y - params.centre_offset * np.sin(yaw),
        )
        self.data.qpos[3:7] = np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
        self.tyres = init_tyres(jnp.result_type(float))
        self.actuators = init_actuators(make_vehicle(params))
        vehicle, index = make_vehicle(params), CarIndex(self.model)

        @jax.jit
        def forces(car, controls):
            return substep_forces(index, vehicle, car, controls, sim.sim_dt)

        self._forces = forces

    def step(self, steer: float, pedal: float) -> np.ndarray:
        """Advances by one `sim_dt`; returns the footprint's pose (3,)."""
        qfrc, ctrl, self.tyres, self.actuators = self._forces(
            CarDynamics(
                jnp.array(self.data.qpos),
                jnp.array(self.data.qvel),
                self.tyres,
                self.actuators,
            ),
            jnp.array([steer, pedal], dtype=jnp.result_type(float)),
        )
        self.data.qfrc_applied[:] = qfrc
        self.data.ctrl[:] = ctrl
        mujoco.mj_step(self.model, self.data)
        return self.pose

    def drive(self, controls: np.ndarray) -> np.ndarray:
        """Steps through `controls` (T, 2); returns the poses (T, 3)."""
        return np.array([self.step(*control) for control in controls])

    @property
    def pose(self) -> np.ndarray:
        """Pose (3,) of the footprint's centre [m, m, rad]."""
        x, y = self.data.qpos[:2]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.data.qpos[3:7])
        yaw = np.arctan2(rotation[3], rotation[0])
        offset = self.params.centre_offset
        return np.array([x + offset * np.cos(yaw), y + offset * np.sin(yaw), yaw])
