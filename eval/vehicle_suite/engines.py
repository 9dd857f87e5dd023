"""Errors of the time step, MJX against C MuJoCo, and the shipped driver's pedal."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import CONTACT_SIM_DT, SimConfig, Surface
from carpark_mj.physics.mjx_step import contact_car_model
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.vehicle import SURFACES, with_grip
from vehicle_suite.report import Study
from vehicle_suite.shipped import CCar, drive
from vehicle_suite.testbed import Run, tracks_of

STEPS, FINEST = (0.01, 0.005, 0.002, 0.001), 0.0005  # s, and that of the reference
TICK, ROLLING = 0.02, 2.0  # s, a control step; m/s, at the start
# One second: pull away turning left, steer over, brake hard, hold.
PEDALS = np.repeat(
    [[1.0, 1.0], [-0.6, 0.8], [0.4, -1.0], [0.4, 0.0]], [20, 15, 10, 5], axis=0
)
BRUSH = SimConfig(ctrl_dt=TICK, trace_dt=TICK)
CONTACT = dataclasses.replace(BRUSH, sim_dt=CONTACT_SIM_DT, tyres="contact")


def convergence(study: Study) -> None:
    """Path error of time steps against the finest, in float64.

    Six seconds: pull away, steer left and right, brake to a stop in a turn.
    """
    weight, lock = study.params.mass * GRAVITY, 0.8 * study.params.max_steering
    until = 4.9999  # s, on a substep of every time step
    wander = Run(
        study.params,
        6.0,
        speed=0.5,
        steering=lambda time: lock * np.sin(1.5 * time),
        force=lambda time: np.where(time > until, 0.0, 0.06 * weight),
        brake=lambda time: np.where(time > until, 0.3 * weight, 0.0),
    )

    def path(dt: float) -> np.ndarray:
        (track,) = tracks_of([wander], dt, x64=True)
        return track.position[:: track.at(0.1)]

    steps, finest = (STEPS[:2], STEPS[-1]) if study.quick else (STEPS, FINEST)
    best = path(finest)
    length = float(np.linalg.norm(np.diff(best, axis=0), axis=1).sum())
    for dt in steps:
        error = float(np.linalg.norm(path(dt) - best, axis=1).max())
        study.row(f"time-step error, {1000 * dt:g} ms", 100 * error / length)


def brush(study: Study) -> None:
    """One second on brush tyres in MJX against C MuJoCo."""
    _against_c(study, "", BRUSH, (32,) if study.quick else (32, 64))


def contact(study: Study) -> None:
    """The same on contact wheels, rigid and on springs.

    MJX compiles one car and takes the others as data (`with_wheels`), all but the
    constants that scale the softness of constraints. C has a model of each car with
    these constants here; what they cost the car against its own is a row, too.
    """
    for suspension in (False,) if study.quick else (False, True):
        sim = dataclasses.replace(CONTACT, suspension=suspension)
        shared, compiled = (contact_car_model(x, sim) for x in (study.params, COMPACT))
        for constant in ("body_invweight0", "dof_invweight0"):
            getattr(shared, constant)[:] = getattr(compiled, constant)
        prefix = "contact wheels on springs: " if suspension else "contact wheels: "
        bits = (32,) if study.quick or suspension else (32, 64)
        path = _against_c(study, prefix, sim, bits, shared)
        apart = np.abs(drive_in_c(study.params, sim) - path).max()
        what = f"{prefix}data of a shared model against an own model, 1 s"
        study.row(what, float(apart))


def _against_c(
    study: Study,
    prefix: str,
    sim: SimConfig,
    precisions: tuple[int, ...],
    model: mujoco.MjModel | None = None,
) -> np.ndarray:
    """Adds a row for each precision of MJX [bits]; returns the path in C."""
    path = drive_in_c(study.params, sim, model)
    for bits in precisions:
        with jax.enable_x64(bits == 64):
            motion = drive(sim, make_vehicle(study.params), PEDALS, ROLLING).motion
            found = np.asarray(motion.pose_w, float)[:, :2]
        apart = float(np.abs(found - path).max())
        study.row(f"{prefix}C MuJoCo against MJX in float{bits}, 1 s", apart)
    return path


def drive_in_c(
    params: VehicleParameters, sim: SimConfig, model: mujoco.MjModel | None = None
) -> np.ndarray:
    """Positions (T, 2) of a car that rolls at first, with `PEDALS`, in C MuJoCo."""
    with jax.enable_x64(True):
        return CCar(params, sim, speed=ROLLING, model=model).drive(PEDALS)[:, :2]


# The shipped driver: `MjxPhysics` drives as in training

SECONDS, DT = 15.0, 0.01  # s, of a drive and between its instants
TAPS, TAP_PEDALS = (10, 20, 30), (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)  # instants
SMOOTH = 5  # instants over which an acceleration is averaged, a fifth of a rocking
PEDAL_STEPS = 20  # of a random drive


def taps(study: Study) -> None:
    """A car at rest whose pedal is tapped and released, both ways.

    It comes to rest without moving back, and below 0.05 m/s without a jerk.
    """
    tapped = np.array([*itertools.product((1.0, -1.0), TAP_PEDALS, TAPS)])
    way, pedal, end = tapped.T
    instant = np.arange(round(SECONDS / DT))[:, None]
    controls = np.zeros((len(instant), len(way), 2))
    controls[..., 1] = np.where(instant < end, way * pedal, 0.0)
    car = make_vehicle(study.params)
    cars = jax.tree.map(lambda x: jnp.stack([x] * len(way)), car)
    motion = drive(SimConfig(ctrl_dt=DT, trace_dt=DT), cars, controls).motion
    speed = way * np.asarray(motion.speed, float)
    acceleration = np.diff(speed, axis=0) / DT
    smooth = np.lib.stride_tricks.sliding_window_view(acceleration, SMOOTH, 0).mean(-1)
    jerk = np.abs(np.diff(smooth, axis=0) / DT)
    middle = (SMOOTH + 1) // 2  # of the instants that a jerk is computed from
    counts = np.abs(speed[middle : middle + len(jerk)]) < 0.05
    jerk = np.where(counts & (instant[: len(jerk)] >= end), jerk, 0.0)
    for tap in TAPS:
        what, those = f"tap of {tap * DT:g} s on the pedal", end == tap
        study.row(f"{what}, rebound", max(float(-speed[:, those].min()), 0.0))
        study.row(f"{what}, jerk below 0.05 m/s", float(jerk[:, those].max()))


def reversing(study: Study) -> None:
    """Path errors of a time step of 10 ms under random pedals, in float64."""
    drives = 8 if study.quick else 48
    surfaces: tuple[Surface, ...] = ("dry", "ice")
    controls = np.zeros((PEDAL_STEPS, drives, 2))
    dice = np.random.default_rng(0)
    controls[..., 1] = dice.uniform(-1.0, 1.0, (PEDAL_STEPS, drives))
    with jax.enable_x64(True):
        car, dry = make_vehicle(study.params), SURFACES["dry"]
        kinds = [with_grip(car, SURFACES[surface] / dry) for surface in surfaces]
        cars = [kind for kind in kinds for _ in range(drives)]
        fleet = jax.tree.map(lambda *x: jnp.stack(x), *cars)
        twice = np.tile(controls, (1, len(surfaces), 1))
        sims = (SimConfig(sim_dt=dt, trace_dt=0.1) for dt in (0.01, 0.001))
        motions = (drive(sim, fleet, twice).motion for sim in sims)
        paths = (np.asarray(motion.trace_w)[..., 0] for motion in motions)
        coarse, exact = (np.moveaxis(x, 2, 1).reshape(-1, len(cars)) for x in paths)
    length = np.abs(np.diff(exact, axis=0)).sum(0)
    error = 100 * np.abs(coarse - exact).max(0) / length
    what = "time-step error, 10 against 1 ms, random reversing"
    for surface, errors in zip(surfaces, np.split(error, len(surfaces)), strict=True):
        for share in (0.5, 0.9, 1.0):
            name = f"{what}, {surface}, quantile {share:g}"
            study.row(name, float(np.quantile(errors, share)))
