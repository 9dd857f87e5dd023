"""The shipped driver and time step, and MJX against C MuJoCo and `mjx.step`."""

import dataclasses
import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import (
    CONTACT_SIM_DT,
    EnvConfig,
    EpisodeConfig,
    SimConfig,
    Surface,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import move_forward
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.collisions import KERB_HEIGHT
from carpark_mj.physics.mjx_step import contact_car_model
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.vehicle import COMPACT, make_vehicle
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.vehicle import SURFACES, with_grip
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


def wheel_stop(study: Study) -> None:
    """A car reverses into a bay until a wheel stop stops its rear tyres."""
    params, distance = study.params, 0.9
    rules: Any = {"parked_rule": "precise", "kerb_speed": 0.6, "respawn": False}
    episode = EpisodeConfig(wheel_stops=distance, **rules)
    config = EnvConfig(num_agents=1, num_parked_cars=0, episode=episode)
    env = ParkingEnv(config, vehicle=params)
    layout = make_layout(env.layout_config)
    bay, (length, _) = layout.bay_pose[0], layout.bay_size[0]
    start = move_forward(bay, 1.0)[None]
    options = ResetOptions(pose=start, goal=jnp.zeros(1, jnp.int32))
    state, _ = jax.jit(env.reset)(jax.random.key(0), options=options)
    step, speed = jax.jit(env.step), 0.0
    for _ in range(60):  # drives back at a walk
        pedal = np.clip(2.0 * (-0.4 - speed), -1.0, 1.0)
        state, timestep = step(state, jnp.array([[0.0, pedal]]))
        speed = float(timestep.motion.speed[0])
    ahead = jnp.array([jnp.cos(bay[2]), jnp.sin(bay[2])])
    to_end = float(jnp.dot(state.motion.xy[0] - bay[:2], ahead))
    found = to_end + float(length) / 2 - params.centre_offset
    reach = math.sqrt(2 * params.wheel_radius * KERB_HEIGHT - KERB_HEIGHT**2)
    height = f"{100 * KERB_HEIGHT:g} cm"
    what = f"wheel stop {height} high, touched at 0.4 m/s, rear axle"
    study.row(what, found, distance + reach)
