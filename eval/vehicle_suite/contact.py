"""The test track of contact wheels: C MuJoCo with the wheels of exported scenes."""

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np

from carpark_mj.physics.coordinates import CarIndex
from carpark_mj.vehicle.contact_wheels import (
    TIMESTEP,
    add_contact_wheels,
    set_contact_options,
)
from carpark_mj.vehicle.mjcf import WHEELS, add_car
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite.formulas import front_wheel_angles
from vehicle_suite.runs import Run, gravity_of
from vehicle_suite.testbed import HOLD_LIMIT
from vehicle_suite.tracks import Track


def contact_model(
    params: VehicleParameters, dt: float, suspension: bool = False
) -> mujoco.MjModel:
    """The car with its steering servos on contact wheels and a plane."""
    spec = mujoco.MjSpec()
    set_contact_options(spec)
    spec.option.timestep = dt
    spec.worldbody.add_geom(
        name="ground", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1]
    )
    add_car(spec.worldbody, spec, params, prefix="", suspension=suspension)
    add_contact_wheels(spec, params, "", "ground", suspension)
    return spec.compile()


def rigid_joints(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the rigid car's `qpos` (13,) and `qvel` (12,) lie in a model's."""
    slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    positions = np.delete(np.arange(model.nq), model.jnt_qposadr[slides])
    return positions, np.delete(np.arange(model.nv), model.jnt_dofadr[slides])


@dataclasses.dataclass(frozen=True)
class ContactTestbed:
    """Plain `mujoco.mj_step`.

    Drive torques are applied to the wheels, brakes are dry friction of the axles
    beside their rolling resistance.

    Attributes:
        dt: substep [s] unless a manoeuvre asks for another.
        suspension: springs between wheels and car; a track leaves their travel out.
    """

    dt: float = TIMESTEP
    suspension: bool = False
    tyres: str = "contact"

    def drive(self, runs: Sequence[Run], dt: float | None = None) -> list[Track]:
        """Drives the runs, one after the other."""
        return [self._drive(run, dt or self.dt) for run in runs]

    def _drive(self, run: Run, dt: float) -> Track:
        params = run.params
        model = contact_model(params, dt, self.suspension)
        data = mujoco.MjData(model)
        positions, velocities = rigid_joints(model)
        spin_dof = CarIndex(model).spin_dof
        data.qpos[positions], data.qvel[velocities] = run.start()
        rolling = model.dof_frictionloss[spin_dof].copy()
        drive_share = np.repeat([params.front_drive, 1 - params.front_drive], 2) / 2
        brake_share = np.repeat([params.front_brake, 1 - params.front_brake], 2) / 2
        signals = run.signals(dt)
        gravity = gravity_of(signals[:, 5])
        most = HOLD_LIMIT * GRAVITY * params.mass
        count = len(signals)
        qpos, qvel = np.zeros((count + 1, 13)), np.zeros((count + 1, 12))
        load, torque = np.zeros((count, 4)), np.zeros((count, 4))
        qpos[0], qvel[0] = data.qpos[positions], data.qvel[velocities]
        rotation, contact = np.zeros(9), np.zeros(6)
        tyres = [model.geom(f"tyre_{name}").id for name in WHEELS]
        for i, (steering, force, brake, target, gain, _) in enumerate(signals):
            mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
            hold = gain * (target - rotation[::3] @ data.qvel[:3])
            force = force + np.clip(hold, -most, most)
            torque[i] = force * params.wheel_radius * drive_share
            data.qfrc_applied[spin_dof] = torque[i]
            model.dof_frictionloss[spin_dof] = (
                rolling + brake * params.wheel_radius * brake_share
            )
            data.ctrl = front_wheel_angles(params, float(steering))
            model.opt.gravity = gravity[i]
            mujoco.mj_step(model, data)
            qpos[i + 1], qvel[i + 1] = data.qpos[positions], data.qvel[velocities]
            for c in range(data.ncon):
                mujoco.mj_contactForce(model, data, c, contact)
                load[i, tyres.index(data.contact[c].geom[1])] += contact[0]
        return Track(run, dt, qpos, qvel, load, torque)
