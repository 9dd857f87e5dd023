"""Mirror symmetry, time step, and MJX against C MuJoCo and `mjx.step`."""

import dataclasses
import math

import jax
import mujoco
import numpy as np

from carpark_mj.config import CONTACT_SIM_DT, SimConfig
from carpark_mj.physics.mjx_step import contact_car_model
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite.report import Study
from vehicle_suite.shipped import CCar, drive
from vehicle_suite.testbeds import BrushTestbed, Run, Testbed

STEPS = {"brush": (0.01, 0.005, 0.002, 0.001), "contact": (0.004, 0.002, 0.001)}  # s
FINEST = 0.0005  # s, the reference
TICK, ROLLING = 0.02, 2.0  # s, a control step; m/s, at the start
# One second: pull away turning left, steer over, brake hard, hold.
PEDALS = np.repeat(
    [[1.0, 1.0], [-0.6, 0.8], [0.4, -1.0], [0.4, 0.0]], [20, 15, 10, 5], axis=0
)


def wander(params: VehicleParameters, side: float = 1.0) -> Run:
    """Six seconds: pull away, steer left and right, brake to a stop in a turn."""
    weight, lock = params.mass * GRAVITY, side * 0.8 * params.max_steering
    until = 4.9999  # s, on a substep of every time step
    return Run(
        params,
        6.0,
        speed=0.5,
        steering=lambda time: lock * np.sin(1.5 * time),
        force=lambda time: np.where(time > until, 0.0, 0.06 * weight),
        brake=lambda time: np.where(time > until, 0.3 * weight, 0.0),
    )


def in_float64(bed: Testbed) -> Testbed:
    """The run in float64, the precision of C MuJoCo."""
    return BrushTestbed(x64=True) if isinstance(bed, BrushTestbed) else bed


def mirror(study: Study) -> None:
    """A mirrored manoeuvre drives the mirrored path, in float64."""
    runs = [wander(study.params), wander(study.params, -1.0)]
    left, right = in_float64(study.bed).drive(runs)
    apart = np.abs(left.position - right.position * [1, -1]).max()
    study.row("mirror symmetry, 6 s", float(apart))


def convergence(study: Study) -> None:
    """Path error of time steps against the finest, in float64."""
    steps, finest = STEPS[study.tyres], FINEST
    if study.quick:
        steps, finest = steps[:2], steps[-1]

    def path(dt: float) -> np.ndarray:
        (track,) = in_float64(study.bed).drive([wander(study.params)], dt)
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
    sim = SimConfig(ctrl_dt=TICK, trace_dt=TICK)
    stepped = dataclasses.replace(sim, stepper="mjx")
    path = drive_in_c(study.params, sim)
    for bits in (32,) if study.quick else (32, 64):
        ours, mjx = (drive_in_mjx(study.params, s, bits) for s in (sim, stepped))
        for what, other in (
            ("C MuJoCo against MJX", path),
            ("unrolled step against mjx.step", mjx),
        ):
            apart = float(np.abs(ours - other).max())
            study.row(f"{what} in float{bits}, 1 s", apart)


def contact_engines(study: Study) -> None:
    """One second in MJX against C MuJoCo, rigid and on springs.

    MJX compiles one car and takes the others as data (`with_wheels`), all but the
    constants that scale the softness of constraints. C has a model of each car with
    these constants here; what they cost the car against its own is a row, too.
    """
    params = study.params
    sim = SimConfig(sim_dt=CONTACT_SIM_DT, ctrl_dt=TICK, trace_dt=TICK, tyres="contact")
    for suspension in (False,) if study.quick else (False, True):
        sim = dataclasses.replace(sim, suspension=suspension)
        prefix = "suspension: " if suspension else ""
        shared, compiled = (contact_car_model(car, sim) for car in (params, COMPACT))
        for constant in ("body_invweight0", "dof_invweight0"):
            getattr(shared, constant)[:] = getattr(compiled, constant)
        path = drive_in_c(params, sim, shared)
        for bits in (32,) if study.quick or suspension else (32, 64):
            apart = np.abs(drive_in_mjx(params, sim, bits) - path).max()
            what = f"{prefix}C MuJoCo against MJX in float{bits}, 1 s"
            study.row(what, float(apart))
        apart = np.abs(drive_in_c(params, sim) - path).max()
        what = f"{prefix}data of a shared model against an own model, 1 s"
        study.row(what, float(apart))


def drive_in_mjx(params: VehicleParameters, sim: SimConfig, bits: int) -> np.ndarray:
    """Positions (T, 2) of a car that rolls at first, with `PEDALS`."""
    with jax.enable_x64(bits == 64):
        motion = drive(sim, make_vehicle(params), PEDALS, ROLLING).motion
        return np.asarray(motion.pose_w, float)[:, :2]


def drive_in_c(
    params: VehicleParameters, sim: SimConfig, model: mujoco.MjModel | None = None
) -> np.ndarray:
    """The same in C MuJoCo, in float64."""
    with jax.enable_x64(True):
        return CCar(params, sim, speed=ROLLING, model=model).drive(PEDALS)[:, :2]
