"""Logs of test drives of a single-track car in NumPy, which shares no code with ours.

Lateral tyre forces follow their slip angles with a relaxation length, the drive its
pedal with a lag, the road wheels the steering wheel with a lag. The car stands where
the brakes have stopped it.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from carpark_mj.identification.log import POSE, RATES, DriveLog
from vehicle_suite.logs import LOG_DT, NOISE

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


def drive(
    car: SingleTrack,
    seed: int,
    stops: bool,
    measured: Sequence[str] = POSE,
    seconds: float = 40.0,
    noise: float = 1.0,
    dt: float = 0.001,
) -> DriveLog:
    """Drives, coasts and brakes in turn, in curves, between 1 and 4 m/s.

    Args:
        car: the car.
        seed: of the driver and the noise.
        stops: whether the brakes stop it in every cycle; the foot stays on them.
        measured: quantities in the log.
        seconds: how long.
        noise: factor on `NOISE`.
        dt: step of the integration [s].
    """
    dice = np.random.default_rng(seed)
    time = np.arange(0, seconds, dt)
    phases, (wide, fast) = dice.uniform(0, 6, 2), dice.uniform([0.2, 0.1], [0.3, 0.15])
    angle = wide * np.sin(0.5 * time + phases[0]) + fast * np.sin(2 * time + phases[1])
    path, pedal = _simulate(car, time, angle, _Driver(dice, stops), dt)
    every = round(LOG_DT / dt)
    rows = {
        name: values[::every]
        + dice.normal(0.0, noise * NOISE[name], len(time[::every]))
        for name, values in zip((*POSE, *RATES), path.T, strict=True)
        if name in measured
    }
    wheel = angle * car.steering_ratio
    names = "steering_wheel", "pedal"
    return DriveLog(time[::every], wheel[::every], pedal[::every], names, rows)


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
