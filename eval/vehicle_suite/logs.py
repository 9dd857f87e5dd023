"""Logs of test drives with known parameters and noise of sensors.

`record` drives in C MuJoCo, `drive_single_track` one in NumPy, which shares no code
with the library: its lateral tyre forces follow their slip angles with a relaxation
length, drive and road wheels follow pedal and steering wheel with lags, and it stands
where the brakes have stopped it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.identification.log import POSE, RATES, DriveLog
from carpark_mj.identification.simulation import Sought
from carpark_mj.vehicle.drive import ackermann
from carpark_mj.vehicle.parameters import VehicleParameters
from vehicle_suite.in_c import CCar

DriveName = Literal[
    "full", "slow", "no braking", "straight", "circle", "stops", "rolling"
]
CYCLE = 10.0  # s: start, hold, brake, stand
# Standard deviations: satellites with corrections, wheel speeds, gyroscope.
NOISE = {"x": 0.02, "y": 0.02, "yaw": 0.003, "speed": 0.03, "yaw_rate": 0.005}
LOG_DT = 0.02  # s


@dataclasses.dataclass(frozen=True)
class Drive:
    """A drive to record: true parameters of a car, which otherwise equals a preset.

    The seed is of the driver's amplitudes and the noise. The kinds `stops` and
    `rolling` belong to `drive_single_track`.
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

        def changed(part: Any, **others: Any) -> Any:
            names = {field.name for field in dataclasses.fields(part)} & {*true}
            return dataclasses.replace(part, **{k: true[k] for k in names}, **others)

        limits = {"steering_rate": 5.0, "max_speed": 90.0, "max_reverse_speed": 90.0}
        return changed(self.params, tyre=changed(self.params.tyre), **limits)

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
    drive: Drive, measured: Sequence[str] = POSE, noise: float = 1.0
) -> DriveLog:
    """Drives in C MuJoCo; `noise` scales `NOISE`."""
    commands, dice = drive.commands(), np.random.default_rng([drive.seed, 1])
    return _log(commands, _drive(drive, *commands), measured, noise, dice)


def _log(
    commands: tuple[np.ndarray, np.ndarray, np.ndarray],
    path: np.ndarray,
    measured: Sequence[str],
    noise: float,
    dice: np.random.Generator,
) -> DriveLog:
    """The log of commands (n,), see `Drive.commands`, and of the motion (n, 5)."""
    every = round(LOG_DT / commands[0][1])
    time, wheel, pedal = (values[::every] for values in commands)
    rows = {
        name: values[::every] + dice.normal(0.0, noise * NOISE[name], len(time))
        for name, values in zip((*POSE, *RATES), path.T, strict=True)
        if name in measured
    }
    return DriveLog(time, wheel, pedal, ("steering_wheel", "pedal"), rows)


def _drive(
    drive: Drive, time: np.ndarray, wheel: np.ndarray, pedal: np.ndarray
) -> np.ndarray:
    """The motion (n, 5): x, y, yaw, speed and yaw rate at the rear axle."""
    true, path = drive.true, []
    # As they arrive at the actuators.
    steer = np.interp(time - true.steering_delay, time, wheel)
    steer = steer / (true.steering_ratio * drive.car.max_steering)
    pedal = np.interp(time - true.pedal_delay, time, pedal)
    with jax.enable_x64(True):
        pose = (drive.car.centre_offset, 0.0, 0.0)  # the rear axle in the origin
        car = CCar(drive.car, SimConfig(sim_dt=drive.sim_dt), pose)
        offset = jnp.array(float(true.steering_offset))
        car.vehicle = dataclasses.replace(car.vehicle, steering_offset=offset)
        steering = steer[0] * car.vehicle.max_steering  # at rest, its wheels turned
        car.actuators = dataclasses.replace(car.actuators, steering=steering)
        wheels = ackermann(car.vehicle, steering + offset)
        car.data.qpos[car.index.steer_qpos] = [float(angle) for angle in wheels]
        for controls in zip(steer, pedal, strict=True):
            qpos, qvel = car.data.qpos, car.data.qvel
            w, x, y, z = qpos[3:7]
            yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
            speed = qvel[0] * np.cos(yaw) + qvel[1] * np.sin(yaw)
            path.append((*qpos[:2], yaw, speed, qvel[5]))
            car.step(controls)
    motion = np.array(path)
    motion[:, 2] = np.unwrap(motion[:, 2])
    return motion


G = 9.81  # m/s^2
SLOW = 0.5  # m/s, below it the wheels roll without slip


@dataclasses.dataclass(frozen=True)
class SingleTrack:
    """The car, in all else near the compact preset. SI units.

    Attributes:
        steering_delay: of the steering; names as in `Sought`.
        steering_lag: time constant, as of our steering servo.
        wheelbase: between the axles.
        to_front: centre of gravity behind the front axle.
        arm: radius of gyration about the vertical.
        rotating: what the wheels' inertia adds to the mass, a share of it.
        front_drive: share of the drive along the steered wheels, the rest is along the
            car.
        front_brake: likewise of the brakes.
    """

    steering_delay: float = 0.08
    pedal_delay: float = 0.18
    steering_ratio: float = 15.4
    steering_offset: float = 0.010
    cornering_stiffness: float = 10.0
    max_acceleration: float = 1.7
    max_deceleration: float = 3.5
    rolling_resistance: float = 0.015
    drive_lag: float = 0.12
    lateral_relaxation: float = 0.4
    patch_radius: float = 0.0
    steering_lag: float = 0.014
    wheelbase: float = 2.637
    to_front: float = 1.05
    arm: float = 1.277
    rotating: float = 0.029
    front_drive: float = 1.0
    front_brake: float = 0.68


def drive_single_track(
    car: SingleTrack,
    seed: int,
    stops: bool,
    measured: Sequence[str] = POSE,
    noise: float = 1.0,
    seconds: float = 40.0,
    dt: float = 0.001,
) -> DriveLog:
    """Drives, coasts and brakes in turn, in curves, between 1 and 4 m/s.

    With `stops` the brakes stop it in every cycle, and the foot stays on them. `noise`
    scales `NOISE`; `dt` is the step of the integration [s].
    """
    dice = np.random.default_rng(seed)
    time = np.arange(0, seconds, dt)
    phases, (wide, fast) = dice.uniform(0, 6, 2), dice.uniform([0.2, 0.1], [0.3, 0.15])
    angle = wide * np.sin(0.5 * time + phases[0]) + fast * np.sin(2 * time + phases[1])
    path, pedal = _simulate(car, time, angle, _Driver(dice, stops), dt)
    commands = time, angle * car.steering_ratio, pedal
    return _log(commands, path, measured, noise, dice)


class _Driver:
    """Drives, coasts and brakes in turn, and moves the pedal gradually."""

    def __init__(self, dice, stops: bool) -> None:
        self._dice, self._slow = dice, 0.0 if stops else 1.0
        self._phase, self._until, self._pedal = 0, 0.5, 0.0
        self._aim, self._fast = 0.0, 0.0

    def pedal(self, now: float, speed: float, dt: float) -> float:
        done = now >= self._until
        if self._phase == 1:
            done = speed > self._fast
        elif self._phase == 3 and speed > self._slow:
            done, self._until = False, now + (0.0 if self._slow else 1.0)
        if done:
            self._phase = (self._phase + 1) % 4
            self._until = now + self._dice.uniform(0.5, 1.5)
            self._fast = self._dice.uniform(2.5, 4.0)
            drive, brake = self._dice.uniform([0.4, 0.25], [0.8, 0.5])
            self._aim = (0.0, drive, 0.0, -brake)[self._phase]
        step = np.clip(self._aim - self._pedal, -4 * dt, 4 * dt)
        self._pedal += step
        return self._pedal


def _simulate(car, time, angle, driver, dt) -> tuple[np.ndarray, np.ndarray]:
    """x, y, yaw, speed, yaw rate (n, 5) of the rear axle, and the pedal (n,)."""
    steer = np.interp(time - car.steering_delay, time, angle)
    late, pedals = round(car.pedal_delay / dt), np.zeros(len(time))
    front, rear = car.to_front, car.wheelbase - car.to_front
    loads = G * np.array([rear, front]) / car.wheelbase  # per mass
    stiff = car.cornering_stiffness * loads
    drives, brakes = (np.array([x, 1 - x]) for x in (car.front_drive, car.front_brake))
    x = y = yaw = v = across = rate = drive = 0.0
    slips, delta, out = np.zeros(2), steer[0], []
    for k, wanted in enumerate(steer):
        pedals[k] = driver.pedal(time[k], v, dt)
        p = pedals[k - late] if k >= late else 0.0
        delta = _lagged(delta, wanted, car.steering_lag, dt)
        turned = delta + car.steering_offset
        drive = _lagged(drive, max(p, 0.0) * car.max_acceleration, car.drive_lag, dt)
        brake = max(-p, 0.0) * car.max_deceleration
        ends = np.array([across + front * rate, across - rear * rate])
        aims = np.arctan2(ends, max(v, 0.1)) - [turned, 0.0]
        slips += dt * max(v, 0.1) / car.lateral_relaxation * (aims - slips)
        force = -stiff * slips
        resists = brake * brakes + car.rolling_resistance * loads
        along = drive * drives - resists * (v > 0 or drive > resists.sum())
        sin, cos = np.sin(turned), np.cos(turned)
        push = along[0] * cos + along[1] - force[0] * sin
        v_next = v + dt * (push / (1 + car.rotating) + across * rate)
        v = max(v_next, 0.0)
        if v < SLOW:
            rate = v * np.tan(turned) / car.wheelbase
            across = rear * rate
            slips[:] = 0.0
        else:
            ahead = force[0] * cos + along[0] * sin
            across += dt * (ahead + force[1] - v * rate)
            moment = front * ahead - rear * force[1]
            rate += dt * moment / car.arm**2
        out.append((x, y, yaw, v, rate))
        left = across - rear * rate
        x += dt * (v * np.cos(yaw) - left * np.sin(yaw))
        y += dt * (v * np.sin(yaw) + left * np.cos(yaw))
        yaw += dt * rate
    return np.array(out), pedals


def _lagged(value, target, lag, dt):
    return target + (value - target) * np.exp(-dt / lag) if lag > 0 else target
