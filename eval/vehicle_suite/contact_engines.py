"""Contact wheels in MJX against `mujoco.mj_step`: the same model, two engines."""

import copy
import dataclasses
import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import CONTACT_SIM_DT, SimConfig
from carpark_mj.physics.contact import WheelIndex, contact_car_model, with_wheels
from carpark_mj.physics.coordinates import CarIndex
from carpark_mj.physics.mjx_step import mjx  # pyright: ignore[reportAttributeAccessIssue]
from carpark_mj.precision import full_float32
from carpark_mj.vehicle import COMPACT, Vehicle, VehicleParameters, make_vehicle
from vehicle_suite.contact import rigid_joints
from vehicle_suite.numerics import wander
from vehicle_suite.runs import Run
from vehicle_suite.table import Study
from vehicle_suite.testbed import Testbed, controls


def contact_engines(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """One second in MJX against C MuJoCo, rigid and on springs.

    MJX compiles one car and takes the others as data (`with_wheels`), all but the
    constants that scale the softness of constraints. C has a model of each car with
    these constants here; what they cost the car against its own is a row, too.
    """
    study = Study(name, bed.tyres)
    run = dataclasses.replace(wander(params), duration=1.0, speed=2.0)
    for suspension in (False,) if quick else (False, True):
        sim = SimConfig(sim_dt=CONTACT_SIM_DT, tyres="contact", suspension=suspension)
        prefix = "suspension: " if suspension else ""
        own = contact_car_model(params, sim)
        shared, compiled = copy.copy(own), contact_car_model(COMPACT, sim)
        for constant in ("body_invweight0", "dof_invweight0"):
            getattr(shared, constant)[:] = getattr(compiled, constant)
        path = _drive_in_c(run, sim, shared)
        brief = quick or suspension
        for bits, tolerance in ((32, 1e-5), (64, 1e-12))[: 1 if brief else 2]:
            apart = np.abs(_drive_in_mjx(run, sim, bits == 64) - path).max()
            what = f"{prefix}C MuJoCo against MJX in float{bits}, 1 s"
            study.row(what, "0", "m", float(apart), 0.0, tolerance)
        study.row(
            f"{prefix}data of a shared model against an own model, 1 s",
            "0 but for the softness of the contacts, which is the compiled car's",
            "m",
            float(np.abs(_drive_in_c(run, sim, own) - path).max()),
            0.0,
            5e-4,
        )
    return study


def _drive_in_c(run: Run, sim: SimConfig, model: mujoco.MjModel) -> np.ndarray:
    """Positions (T + 1, 2) in C MuJoCo; the driver computes in float64."""
    with jax.enable_x64(True):
        vehicle = make_vehicle(run.params)
        index, data = CarIndex(model), mujoco.MjData(model)
        positions, velocities = rigid_joints(model)
        data.qpos[positions], data.qvel[velocities] = run.start()
        rolling = model.dof_frictionloss[index.spin_dof].copy()
        path = [data.qpos[:2].copy()]
        for signal in run.signals(sim.sim_dt):
            ctrl, drive, brake = _controls(
                vehicle, jnp.array(signal), jnp.array(data.qpos), jnp.array(data.qvel)
            )
            data.ctrl, data.qfrc_applied[index.spin_dof] = ctrl, drive
            model.dof_frictionloss[index.spin_dof] = rolling + brake
            data.qacc_warmstart[:] = 0.0  # as MJX, which carries none
            mujoco.mj_step(model, data)
            path.append(data.qpos[:2].copy())
    return np.array(path)


_controls = jax.jit(controls)


def _drive_in_mjx(run: Run, sim: SimConfig, x64: bool) -> np.ndarray:
    """Positions (T + 1, 2) in MJX."""
    with jax.enable_x64(x64):
        dtype = jnp.result_type(float)
        positions, velocities = rigid_joints(contact_car_model(COMPACT, sim))
        qpos, qvel = np.zeros(len(positions)), np.zeros(len(velocities))
        qpos[:], qvel[:] = run.start()
        path = _program(sim, x64)(
            make_vehicle(run.params),
            jnp.array(qpos, dtype),
            jnp.array(qvel, dtype),
            jnp.array(run.signals(sim.sim_dt), dtype),
        )
        return np.vstack([qpos[:2], np.asarray(path, float)])


@functools.cache
def _program(sim: SimConfig, x64: bool):
    """Compiles a drive of one car, once for each model and precision.

    Arguments: the car, rigid positions (13,) and velocities (12,), signals (T, 6); the
    suspension starts at rest. Returns positions (T, 2).
    """
    del x64  # the arrays' precision; a key of the cache
    compiled = contact_car_model(COMPACT, sim)
    index, wheels = CarIndex(compiled), WheelIndex(compiled)
    positions, velocities = rigid_joints(compiled)
    model = mjx.put_model(compiled)
    data = mjx.make_data(model)

    @jax.jit
    @full_float32
    def drive(vehicle: Vehicle, qpos: jax.Array, qvel: jax.Array, signals: jax.Array):
        body = {
            name: getattr(vehicle, name)
            for name in ("body_mass", "body_inertia", "body_ipos", "body_pos")
        }

        def substep(carry, signal):
            qpos, qvel = carry
            ctrl, torque, brake = controls(vehicle, signal, qpos, qvel)
            car = with_wheels(model.tree_replace(body), index, wheels, vehicle, brake)
            applied = jnp.zeros_like(qvel).at[index.spin_dof].set(torque)
            after = mjx.step(
                car, data.replace(qpos=qpos, qvel=qvel, qfrc_applied=applied, ctrl=ctrl)
            )
            return (after.qpos, after.qvel), after.qpos[:2]

        full = jnp.zeros(compiled.nq, qpos.dtype).at[positions].set(qpos)
        speeds = jnp.zeros(compiled.nv, qpos.dtype).at[velocities].set(qvel)
        return jax.lax.scan(substep, (full, speeds), signals)[1]

    return drive
