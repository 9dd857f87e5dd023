"""MJX with contact wheels: the cross-check of the brush tyres.

The wheels of `carpark_mj.vehicle.contact_wheels` under the same driver as `mjx`: drive
torques through open differentials, brakes and rolling resistance as dry friction of
the axles, changed while it runs. They have no bristles: `CarState.tyres` stays zero.

Settings that survive locked wheels in MJX, where fewer iterations throw the car:
elliptic cone, impratio 1, 20 Newton iterations with 50 line-search steps, substeps of
at most 4 ms. The ground is a plane; a slope is tilted gravity.
"""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from carpark_mj.config import SimConfig
from carpark_mj.physics.car import gravity_vector, rotation_matrix
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.contact_wheels import add_contact_wheels, set_contact_options
from carpark_mj.vehicle.mjcf import WHEELS, add_car
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import COMPACT
from carpark_mj.vehicle.vehicle import Vehicle

IMPRATIO = 1.0
ITERATIONS, LS_ITERATIONS = 20, 50


def contact_car_model(params: VehicleParameters, sim: SimConfig) -> mujoco.MjModel:
    """Compiles the car with its steering servos on contact wheels and a plane."""
    spec = mujoco.MjSpec()
    set_contact_options(spec)
    spec.option.timestep = sim.sim_dt
    spec.option.gravity = gravity_vector(sim)
    spec.option.impratio = IMPRATIO
    spec.option.iterations, spec.option.ls_iterations = ITERATIONS, LS_ITERATIONS
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 1.0],
        contype=0,
        conaffinity=0,
    )
    add_car(spec.worldbody, spec, params, prefix="")
    add_contact_wheels(spec, params, "", "ground")
    return spec.compile()


def axle_friction(vehicle: Vehicle, brake: jax.Array) -> jax.Array:
    """Dry friction (4,) [N m] of the wheels for brake torques (4,) [N m]."""
    rolling = vehicle.tyres.rolling_resistance * vehicle.tyres.static_load
    return brake + rolling * vehicle.wheel_radius


class ContactPhysics(MjxPhysics):
    """MJX with contact wheels behind the `Physics` interface."""

    def __init__(self, sim: SimConfig) -> None:
        """Compiles the car model for the given time steps, slope and surface."""
        super().__init__(sim)
        model = contact_car_model(COMPACT, sim)
        self._tyres = np.array([model.geom(f"tyre_{wheel}").id for wheel in WHEELS])

    def _compile(self, sim: SimConfig) -> mujoco.MjModel:
        return contact_car_model(COMPACT, sim)

    def _substep(
        self, model: mjx.Model, vehicle: Vehicle, controls: jax.Array, carry: Any
    ) -> Any:
        qpos, qvel, tyres, actuators = carry
        spin_dof = self.index.spin_dof
        speed = rotation_matrix(qpos[3:7])[:, 0] @ qvel[:3]
        actuators, ctrl, torque, brake = drive.actuate(
            vehicle, actuators, controls, speed, qvel[spin_dof], self.sim.sim_dt
        )
        loss = model.dof_frictionloss.at[spin_dof].set(axle_friction(vehicle, brake))
        model = model.tree_replace(
            {
                "dof_frictionloss": loss,
                "pair_friction": model.pair_friction.at[:, :2].set(
                    vehicle.tyres.friction
                ),
                "geom_size": model.geom_size.at[self._tyres, 0].set(
                    vehicle.wheel_radius
                ),
            }
        )
        data = self._data.replace(
            qpos=qpos,
            qvel=qvel,
            qfrc_applied=jnp.zeros_like(qvel).at[spin_dof].set(torque),
            ctrl=ctrl,
        )
        data = mjx.step(model, data)
        return data.qpos, data.qvel, tyres, actuators
