"""Numerics of the brush testbed: symmetry, time step, C MuJoCo against MJX."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.physics.mjx import apply_torques
from carpark_mj.physics.tyres import init_tyres
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from physics.cornering import Cars
from physics.runs import INDEX, Run
from physics.table import Curve, Row, Study
from physics.testbed import BrushTestbed, Testbed, controls, vehicle_of

FINEST = 0.0005  # s, the reference of the convergence
STEPS = (0.01, 0.005, 0.002, 0.001)  # s


def wander(params: VehicleParameters, side: float = 1.0) -> Run:
    """Six seconds: pull away, steer from lock to lock, brake to a stop in a turn."""

    def brake(time: np.ndarray) -> np.ndarray:
        return np.where(time > 4.999, SERVICE * params.mass * GRAVITY, 0.0)

    def drive(time: np.ndarray) -> np.ndarray:
        return np.where(time > 4.999, 0.0, 0.06 * params.mass * GRAVITY)

    def steering(time: np.ndarray) -> np.ndarray:
        return side * 0.8 * params.max_steering * np.sin(1.5 * time)

    return Run(params, 6.0, speed=0.5, steering=steering, force=drive, brake=brake)


SERVICE = 0.3  # g


def mirror(bed: Testbed, cars: Cars) -> Study:
    """A mirrored manoeuvre drives the mirrored path."""
    study = Study()
    for name, params in cars.items():
        left, right = bed.drive([wander(params), wander(params, -1.0)])
        apart = np.abs(left.position - right.position * [1, -1]).max()
        study.rows.append(
            Row("mirror symmetry, 6 s", name, bed.tyres, "0", "m", float(apart), 0.0,
                1e-6 if not isinstance(bed, BrushTestbed) or bed.x64 else 1e-5,
                "" if not isinstance(bed, BrushTestbed) or bed.x64 else "float32 rounding")
        )  # fmt: skip
    return study


def convergence(cars: Cars, quick: bool = False) -> Study:
    """Path error of time steps against 0.5 ms, in float64."""
    study, bed = Study(), BrushTestbed(x64=True)
    steps = (0.01, 0.005) if quick else STEPS
    finest = 0.001 if quick else FINEST
    names, runs = list(cars), [wander(p) for p in cars.values()]
    every = 0.1

    def paths(dt: float) -> list[np.ndarray]:
        stride = round(every / dt)
        return [track.position[::stride] for track in bed.drive(runs, dt)]

    exact, found = paths(finest), {dt: paths(dt) for dt in steps}
    for i, name in enumerate(names):
        length = float(np.linalg.norm(np.diff(exact[i], axis=0), axis=1).sum())
        errors = {
            dt: float(np.linalg.norm(found[dt][i] - exact[i], axis=1).max())
            for dt in steps
        }
        for dt in steps:
            study.rows.append(
                Row(f"time-step error, {1000 * dt:g} ms", name, bed.tyres,
                    f"O(dt), of a {length:.0f} m path against {1000 * finest:g} ms", "m",
                    errors[dt], 0.0, 0.005 * length * dt / 0.01)
            )  # fmt: skip
        coarse, fine = steps[0], steps[1]
        slope = math.log(
            errors[coarse] / errors[fine]
        ) / math.log((coarse - finest) / (fine - finest))  # fmt: skip
        study.rows.append(
            Row("time-step order, 10 against 5 ms", name, bed.tyres,
                "1: error ~ dt - dt_ref", "", slope, 1.0, 0.3)
        )  # fmt: skip
        study.curves.append(
            Curve("convergence", name, [1000 * dt for dt in steps],
                  [1000 * errors[dt] for dt in steps], "o-")
        )  # fmt: skip
    return study


def engines(cars: Cars) -> Study:
    """One second in MJX against `mujoco.mj_step` with the same tyre code."""
    study, count = Study(), 100
    for (name, params), x64 in itertools.product(cars.items(), (False, True)):
        bed = BrushTestbed(x64=x64)
        run = dataclasses.replace(wander(params), duration=1.0, speed=2.0)
        path = in_c(run, bed.dt)[: count + 1]
        (track,) = bed.drive([run])
        study.rows.append(
            Row(f"C MuJoCo against MJX in float{64 if x64 else 32}, 1 s", name,
                bed.tyres, "0", "m", float(np.abs(track.position - path).max()), 0.0,
                1e-12 if x64 else 1e-5)
        )  # fmt: skip
    return study


def in_c(run: Run, dt: float) -> np.ndarray:
    """Positions (T + 1, 2) of the run in C MuJoCo, all in float64."""
    with jax.enable_x64(True):
        vehicle, tyres = vehicle_of(run), init_tyres(jnp.result_type(float))
        model = car_model(run.params, dt, (0.0, 0.0, -GRAVITY))
        data = mujoco.MjData(model)
        data.qpos, data.qvel = run.start()

        @jax.jit
        def forces(qpos, qvel, tyres, signal):
            ctrl, drive, brake = controls(vehicle, signal, qpos, qvel)
            applied = apply_torques(INDEX, vehicle, qpos, qvel, tyres, drive, brake, dt)
            return ctrl, applied[0], applied[2]

        path = [data.qpos[:2].copy()]
        for signal in run.signals(dt):
            data.ctrl, data.qfrc_applied, tyres = forces(
                jnp.array(data.qpos), jnp.array(data.qvel), tyres, jnp.array(signal)
            )
            mujoco.mj_step(model, data)
            path.append(data.qpos[:2].copy())
    return np.array(path)
