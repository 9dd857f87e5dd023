"""Numerics: mirror symmetry, time step, agreement with C MuJoCo and `mjx.step`."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.physics.forces import generalized_forces
from carpark_mj.physics.tyres import init_tyres
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite.runs import INDEX, Run
from vehicle_suite.table import Study
from vehicle_suite.testbed import (
    BrushTestbed,
    Testbed,
    controls,
    tyres_on_car,
    vehicle_of,
)

STEPS = {"brush": (0.01, 0.005, 0.002, 0.001), "contact": (0.004, 0.002, 0.001)}  # s
LONGEST = 0.01  # s, at which half a per cent of the path is allowed
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
    """The same in float64, which C MuJoCo computes in anyway."""
    return BrushTestbed(x64=True) if isinstance(bed, BrushTestbed) else bed


def mirror(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """A mirrored manoeuvre drives the mirrored path, in float64."""
    del quick
    study = Study(name, bed.tyres)
    left, right = in_float64(bed).drive([wander(params), wander(params, -1.0)])
    apart = np.abs(left.position - right.position * [1, -1]).max()
    study.row("mirror symmetry, 6 s", "0", "m", float(apart), 0.0, 1e-6)
    return study


def convergence(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Path error of time steps against the finest, in float64."""
    study = Study(name, bed.tyres)
    steps = STEPS[bed.tyres]
    steps, finest = (steps[:2], steps[-1]) if quick else (steps, FINEST)
    exact = in_float64(bed)

    def path(dt: float) -> np.ndarray:
        (track,) = exact.drive([wander(params)], dt)
        return track.position[:: track.at(0.1)]

    best = path(finest)
    length = float(np.linalg.norm(np.diff(best, axis=0), axis=1).sum())
    errors = [float(np.linalg.norm(path(dt) - best, axis=1).max()) for dt in steps]
    for dt, error in zip(steps, errors, strict=True):
        study.row(
            f"time-step error, {1000 * dt:g} ms",
            "0.5 % of the path at 10 ms, in proportion to dt",
            "% of the path",
            100 * error / length,
            0.0,
            0.5 * dt / LONGEST,
        )
    spread = math.log((steps[0] - finest) / (steps[1] - finest))
    study.row(
        f"time-step order, {1000 * steps[0]:g} against {1000 * steps[1]:g} ms",
        "1: error in proportion to dt - dt_ref",
        "",
        math.log(errors[0] / errors[1]) / spread,
        1.0,
        0.3,
    )
    milli = 1000 * np.array(steps)
    study.curve("convergence", "measured", milli, 1000 * np.array(errors), "o-")
    bound = 5 * length * milli / 10
    study.curve("convergence", "tolerance", milli, bound, "--")
    return study


def engines(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """One second of the unrolled step against C MuJoCo and `mjx.step`, same tyres."""
    study = Study(name, bed.tyres)
    run = dataclasses.replace(wander(params), duration=1.0, speed=2.0)
    path = drive_in_c(run, bed.dt)
    for bits, tolerance in ((32, 1e-5), (64, 1e-12))[: 1 if quick else 2]:
        ours = BrushTestbed(bed.dt, x64=bits == 64)
        (track,) = ours.drive([run])
        (reference,) = dataclasses.replace(ours, stepper="mjx").drive([run])
        judges = {
            "C MuJoCo against MJX": path,
            "unrolled step against mjx.step": reference.position,
        }
        for what, other in judges.items():
            apart = float(np.abs(track.position - other).max())
            study.row(f"{what} in float{bits}, 1 s", "0", "m", apart, 0.0, tolerance)
    return study


def drive_in_c(run: Run, dt: float) -> np.ndarray:
    """Positions (T + 1, 2) of the run in C MuJoCo, all in float64."""
    with jax.enable_x64(True):
        vehicle, tyres = vehicle_of(run), init_tyres(jnp.result_type(float))
        model = car_model(run.params, dt, (0.0, 0.0, -GRAVITY))
        data = mujoco.MjData(model)
        data.qpos, data.qvel = run.start()
        path = [data.qpos[:2].copy()]
        for signal in run.signals(dt):
            ctrl, qfrc, tyres = _c_forces(
                vehicle,
                jnp.array(data.qpos),
                jnp.array(data.qvel),
                tyres,
                jnp.array(signal),
                dt,
            )
            data.ctrl, data.qfrc_applied = ctrl, qfrc
            mujoco.mj_step(model, data)
            path.append(data.qpos[:2].copy())
    return np.array(path)


@jax.jit
def _c_forces(vehicle, qpos, qvel, tyres, signal, dt):
    ctrl, drive, brake = controls(vehicle, signal, qpos, qvel)
    forces, tyres = tyres_on_car(vehicle, qpos, qvel, tyres, (drive, brake), dt)
    return ctrl, generalized_forces(INDEX, forces), tyres
