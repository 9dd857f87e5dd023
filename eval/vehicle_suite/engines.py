"""Mirror symmetry, time step, and MJX against C MuJoCo and `mjx.step`."""

import copy
import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import CONTACT_SIM_DT, SimConfig
from carpark_mj.physics.coordinates import CarDynamics, init_tyres
from carpark_mj.physics.forces import generalized_forces
from carpark_mj.physics.mjx_step import (
    ContactStep,
    WheelIndex,
    contact_car_model,
    with_masses,
    with_wheels,
)
from carpark_mj.precision import full_float32
from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import init_actuators
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite.report import Study
from vehicle_suite.testbeds import (
    BrushTestbed,
    ContactTestbed,
    Testbed,
    controls,
    drive_in_c,
    rigid_joints,
    tyres_on_car,
    vehicle_of,
)
from vehicle_suite.track import INDEX, Run

STEPS = {"brush": (0.01, 0.005, 0.002, 0.001), "contact": (0.004, 0.002, 0.001)}  # s
FINEST = 0.0005  # s, the reference


def wander(params: VehicleParameters, side: float = 1.0) -> Run:
    """Six seconds: pull away, steer left and right, brake to a stop in a turn."""
    weight = params.mass * GRAVITY

    def braking(time: np.ndarray) -> np.ndarray:
        return time > 4.9999  # s, on a substep of every time step

    return Run(
        params,
        6.0,
        speed=0.5,
        steering=lambda time: side * 0.8 * params.max_steering * np.sin(1.5 * time),
        force=lambda time: np.where(braking(time), 0.0, 0.06 * weight),
        brake=lambda time: np.where(braking(time), 0.3 * weight, 0.0),
    )


def in_float64(bed: Testbed) -> Testbed:
    """The run in float64, the precision of C MuJoCo."""
    return BrushTestbed(x64=True) if isinstance(bed, BrushTestbed) else bed


def mirror(study: Study) -> None:
    """A mirrored manoeuvre drives the mirrored path, in float64."""
    params = study.params
    left, right = in_float64(study.bed).drive([wander(params), wander(params, -1.0)])
    apart = np.abs(left.position - right.position * [1, -1]).max()
    study.row("mirror symmetry, 6 s", float(apart))


def convergence(study: Study) -> None:
    """Path error of time steps against the finest, in float64."""
    params = study.params
    steps = STEPS[study.tyres]
    steps, finest = (steps[:2], steps[-1]) if study.quick else (steps, FINEST)
    exact = in_float64(study.bed)

    def path(dt: float) -> np.ndarray:
        (track,) = exact.drive([wander(params)], dt)
        return track.position[:: track.at(0.1)]

    best = path(finest)
    length = float(np.linalg.norm(np.diff(best, axis=0), axis=1).sum())
    errors = [float(np.linalg.norm(path(dt) - best, axis=1).max()) for dt in steps]
    for dt, error in zip(steps, errors, strict=True):
        study.row(f"time-step error, {1000 * dt:g} ms", 100 * error / length)
    order = math.log(errors[0] / errors[1])
    order /= math.log((steps[0] - finest) / (steps[1] - finest))
    what = f"time-step order, {1000 * steps[0]:g} against {1000 * steps[1]:g} ms"
    study.row(what, order, 1.0)
    milli = 1000 * np.array(steps)
    study.curve("convergence", "measured", milli, 1000 * np.array(errors), "o-")
    bound = 5 * length * milli / 10
    study.curve("convergence", "tolerance", milli, bound, "--")


def brush_engines(study: Study) -> None:
    """One second of the unrolled step against C MuJoCo and `mjx.step`, same tyres."""
    params = study.params
    run = dataclasses.replace(wander(params), duration=1.0, speed=2.0)
    path = drive_brush_in_c(run, study.bed.dt)
    for bits in (32,) if study.quick else (32, 64):
        ours = BrushTestbed(study.bed.dt, x64=bits == 64)
        (track,) = ours.drive([run])
        (reference,) = dataclasses.replace(ours, stepper="mjx").drive([run])
        for what, other in (
            ("C MuJoCo against MJX", path),
            ("unrolled step against mjx.step", reference.position),
        ):
            apart = float(np.abs(track.position - other).max())
            study.row(f"{what} in float{bits}, 1 s", apart)


def drive_brush_in_c(run: Run, dt: float) -> np.ndarray:
    """Positions (T + 1, 2) of the run in C MuJoCo on our tyres, all in float64."""
    model = car_model(run.params, dt, (0.0, 0.0, -GRAVITY))
    with jax.enable_x64(True):
        vehicle, tyres = vehicle_of(run), init_tyres(jnp.result_type(float))

        def act(data: Any, signal: np.ndarray) -> None:
            nonlocal tyres
            at = jnp.array(data.qpos), jnp.array(data.qvel)
            acting = _brush_forces(vehicle, *at, tyres, jnp.array(signal), dt)
            data.ctrl, data.qfrc_applied, tyres = acting

        return drive_in_c(run, model, act)[0][:, :2]


@jax.jit
def _brush_forces(vehicle, qpos, qvel, tyres, signal, dt):
    ctrl, drive, brake = controls(vehicle, signal, qpos, qvel)
    forces, tyres = tyres_on_car(vehicle, qpos, qvel, tyres, (drive, brake), dt)
    return ctrl, generalized_forces(INDEX, forces), tyres


def contact_engines(study: Study) -> None:
    """One second in MJX against C MuJoCo, rigid and on springs.

    MJX compiles one car and takes the others as data (`with_wheels`), all but the
    constants that scale the softness of constraints. C has a model of each car with
    these constants here; what they cost the car against its own is a row, too.
    """
    params = study.params
    run = dataclasses.replace(wander(params), duration=1.0, speed=2.0)
    for suspension in (False,) if study.quick else (False, True):
        sim = SimConfig(sim_dt=CONTACT_SIM_DT, tyres="contact", suspension=suspension)
        prefix = "suspension: " if suspension else ""
        own = contact_car_model(params, sim)
        shared, compiled = copy.copy(own), contact_car_model(COMPACT, sim)
        for constant in ("body_invweight0", "dof_invweight0"):
            getattr(shared, constant)[:] = getattr(compiled, constant)
        bed = ContactTestbed(suspension=suspension)
        # From nothing, as MJX, which carries no warm start.
        path = bed.drive_model(run, shared, cold=True).position
        for bits in (32,) if study.quick or suspension else (32, 64):
            apart = np.abs(_drive_in_mjx(run, sim, bits == 64) - path).max()
            what = f"{prefix}C MuJoCo against MJX in float{bits}, 1 s"
            study.row(what, float(apart))
        apart = np.abs(bed.drive_model(run, own, cold=True).position - path).max()
        what = f"{prefix}data of a shared model against an own model, 1 s"
        study.row(what, float(apart))


def _drive_in_mjx(run: Run, sim: SimConfig, x64: bool) -> np.ndarray:
    """Positions (T + 1, 2) in MJX."""
    with jax.enable_x64(x64):
        start = run.start()
        inputs = (jnp.array(x, float) for x in (*start, run.signals(sim.sim_dt)))
        path = _program(sim, x64)(make_vehicle(run.params), *inputs)
        return np.vstack([start[0][:2], np.asarray(path, float)])


@functools.cache
def _program(sim: SimConfig, x64: bool):
    """Compiles a drive of one car, once for each model and precision.

    Arguments: the car, rigid positions (13,) and velocities (12,), signals (T, 6); the
    suspension starts at rest. Returns positions (T, 2).
    """
    del x64  # the arrays' precision; a key of the cache
    compiled = contact_car_model(COMPACT, sim)
    step = ContactStep(compiled, sim)
    index, wheels = step.index, WheelIndex(compiled)
    positions, velocities = rigid_joints(compiled)

    @jax.jit
    @full_float32
    def drive(vehicle: Vehicle, qpos: jax.Array, qvel: jax.Array, signals: jax.Array):
        masses = with_masses(step.model, vehicle)
        start = CarDynamics(
            jnp.zeros(compiled.nq, qpos.dtype).at[positions].set(qpos),
            jnp.zeros(compiled.nv, qpos.dtype).at[velocities].set(qvel),
            init_tyres(qpos.dtype),
            init_actuators(vehicle),
        )

        def substep(car: CarDynamics, signal: jax.Array):
            ctrl, torque, brake = controls(vehicle, signal, car.qpos, car.qvel)
            model = with_wheels(masses, index, wheels, vehicle, brake)
            applied = jnp.zeros_like(car.qvel).at[index.spin_dof].set(torque)
            car = step.integrate(model, car, applied, ctrl)
            return car, car.qpos[:2]

        return jax.lax.scan(substep, start, signals)[1]

    return drive
