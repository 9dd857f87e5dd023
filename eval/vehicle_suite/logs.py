"""Logs of test drives in C MuJoCo, with known parameters and noise of sensors."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.identification.log import POSE, RATES, DriveLog
from carpark_mj.identification.simulation import Sought
from carpark_mj.physics.coordinates import CarDynamics, CarIndex
from carpark_mj.physics.forces import substep_forces
from carpark_mj.physics.tyres import init_tyres
from carpark_mj.vehicle.drive import ackermann, init_actuators
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.vehicle import make_vehicle

DriveName = Literal[
    "full", "slow", "no braking", "straight", "circle", "stops", "rolling"
]
CYCLE = 10.0  # s: start, hold, brake, stand
# Standard deviations: satellites with corrections, wheel speeds, gyroscope.
NOISE = {"x": 0.02, "y": 0.02, "yaw": 0.003, "speed": 0.03, "yaw_rate": 0.005}
LOG_DT = 0.02  # s


@dataclasses.dataclass(frozen=True)
class Drive:
    """A drive to record.

    Attributes:
        true: parameters of the car.
        kind: what the driver does; `stops` and `rolling` are of `single_track`.
        params: the car in all else.
        seed: of the driver's amplitudes and of the noise.
        seconds: how long it lasts.
        sim_dt: step of the engine [s].
    """

    true: Sought
    params: VehicleParameters
    kind: DriveName = "full"
    seed: int = 0
    seconds: float = 40.0
    sim_dt: float = 0.002

    @property
    def car(self) -> VehicleParameters:
        """The true car: no speed limit, wheels that turn as fast as the driver."""
        true = {name: float(value) for name, value in self.true._asdict().items()}
        names = {field.name for field in dataclasses.fields(self.params.tyre)}
        tyre = {name: true[name] for name in names & {*true}}
        tyre = dataclasses.replace(self.params.tyre, **tyre)
        return dataclasses.replace(
            self.params,
            max_acceleration=true["max_acceleration"],
            max_deceleration=true["max_deceleration"],
            drive_lag=true["drive_lag"],
            steering_rate=5.0,
            max_speed=90.0,
            max_reverse_speed=90.0,
            tyre=tyre,
        )

    def commands(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (n,) [s], angles of the steering wheel (n,) [rad], pedal (n,)."""
        dice = np.random.default_rng(self.seed)
        time = np.arange(0, self.seconds, self.sim_dt)
        phase, (wide, fast) = dice.uniform(0, 6), dice.uniform([0.3, 0.1], [0.4, 0.2])
        angle = wide * np.sin(0.5 * time + phase) + fast * np.sin(1.7 * time)
        pedal, moment = np.zeros_like(time), time % CYCLE
        drive, brake = dice.uniform([0.5, 0.3], [0.65, 0.45])
        if self.kind == "slow":
            drive, angle = 0.6 * drive, 0.3 * angle
        if self.kind == "no braking":
            drive, brake = 0.5 * drive, 0.0
        pedal += drive * ((moment > 0.5) & (moment < 3.5))
        pedal += 0.1 * ((moment >= 3.5) & (moment < 6.0))
        pedal -= brake * ((moment > 6.0) & (moment < 9.0))
        if self.kind == "no braking":
            pedal *= time < 0.6 * self.seconds
        if self.kind == "straight":
            angle *= 0.0
        if self.kind == "circle":
            angle = np.full_like(time, 0.4)
        width = round(0.3 / self.sim_dt)
        pedal = np.convolve(pedal, np.full(width, 1 / width), "same")
        return time, angle * float(self.true.steering_ratio), pedal


def record(
    drives: Sequence[Drive], measured: Sequence[str] = POSE, noise: float = 1.0
) -> list[DriveLog]:
    """Drives in C MuJoCo, all of one length and step.

    Args:
        drives: what to drive.
        measured: quantities in the logs, at the rear axle.
        noise: factor on `NOISE`.
    """
    commands = [drive.commands() for drive in drives]
    motion = _drive(drives, commands)
    logs = []
    every = round(LOG_DT / drives[0].sim_dt)
    for drive, (time, wheel, pedal), path in zip(drives, commands, motion, strict=True):
        dice = np.random.default_rng([drive.seed, 1])
        rows = {
            name: values[::every]
            + dice.normal(0.0, noise * NOISE[name], len(time[::every]))
            for name, values in zip((*POSE, *RATES), path.T, strict=True)
            if name in measured
        }
        names = "steering_wheel", "pedal"
        logs.append(
            DriveLog(time[::every], wheel[::every], pedal[::every], names, rows)
        )
    return logs


def _drive(drives: Sequence[Drive], commands: Sequence[tuple]) -> np.ndarray:
    """The motion (drives, n, 5): x, y, yaw, speed and yaw rate at the rear axle."""
    dt = drives[0].sim_dt
    with jax.enable_x64(True):
        vehicle = jax.tree.map(lambda *x: jnp.stack(x), *map(_vehicle, drives))
        models = [car_model(d.car, dt, (0.0, 0.0, -GRAVITY)) for d in drives]
        datas = [mujoco.MjData(model) for model in models]
        index = CarIndex(models[0])
        arriving = _controls(drives, commands)
        steering = jnp.asarray(arriving[0, :, 0]) * vehicle.max_steering
        wheels = ackermann(vehicle, steering + vehicle.steering_offset)
        for k, data in enumerate(datas):  # at rest, their wheels turned
            data.qpos[index.steer_qpos] = [float(wheel[k]) for wheel in wheels]
        zeros = jnp.zeros((len(drives), 4), jnp.result_type(float))
        tyres = jax.tree.map(lambda x: x + zeros, init_tyres(zeros.dtype))
        actuators = dataclasses.replace(init_actuators(vehicle), steering=steering)
        forces = jax.jit(lambda car, c: substep_forces(index, vehicle, car, c, dt))
        path = []
        for controls in arriving:
            qpos, qvel = (
                np.stack([getattr(d, n) for d in datas]) for n in ("qpos", "qvel")
            )
            path.append(_seen(qpos, qvel))
            car = CarDynamics(jnp.array(qpos), jnp.array(qvel), tyres, actuators)
            qfrc, ctrl, tyres, actuators = forces(car, controls)
            qfrc, ctrl = np.asarray(qfrc), np.asarray(ctrl)
            for k, (model, data) in enumerate(zip(models, datas, strict=True)):
                data.qfrc_applied[:], data.ctrl[:] = qfrc[k], ctrl[k]
                mujoco.mj_step(model, data)
    motion = np.stack(path, axis=1)
    motion[..., 2] = np.unwrap(motion[..., 2], axis=1)
    return motion


def _vehicle(drive: Drive):
    offset = jnp.asarray(float(drive.true.steering_offset))
    return dataclasses.replace(make_vehicle(drive.car), steering_offset=offset)


def _controls(drives: Sequence[Drive], commands: Sequence[tuple]) -> np.ndarray:
    """Steer and pedal (n, drives, 2) as they arrive at the actuators."""
    late = []
    for drive, (time, wheel, pedal) in zip(drives, commands, strict=True):
        true = drive.true
        steer = np.interp(time - true.steering_delay, time, wheel) / (
            true.steering_ratio * drive.car.max_steering
        )
        late.append(
            np.stack([steer, np.interp(time - true.pedal_delay, time, pedal)], -1)
        )
    return np.stack(late, axis=1)


def _seen(qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    w, x, y, z = qpos[:, 3:7].T
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    speed = qvel[:, 0] * np.cos(yaw) + qvel[:, 1] * np.sin(yaw)
    return np.stack([qpos[:, 0], qpos[:, 1], yaw, speed, qvel[:, 5]], axis=-1)
