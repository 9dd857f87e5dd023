"""Runs: the inputs of a test driver.

A run gives signals over time: steering angle, drive and brake force at the wheels, a
speed to hold, the tilt of the ground. They act at once: no pedal, no rate limit and no
speed limiter stands between the standard's manoeuvre and the car.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from carpark_mj.physics.coordinates import CarIndex
from carpark_mj.vehicle import COMPACT
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters

Signal = float | Callable[[np.ndarray], np.ndarray]  # a constant, or of time (T,) [s]

LOCKING = 20.0  # g, a brake force over the weight that locks every wheel at once
SPEED_GAIN = 3.0  # 1/s, acceleration per speed error of the test driver


@dataclasses.dataclass(frozen=True)
class Run:
    """One car and its manoeuvre.

    Attributes:
        params: the car.
        duration: [s].
        heading: of the car at the start [rad].
        speed: at the start, with rolling wheels [m/s].
        steering: bicycle angle [rad], both wheels by the Ackermann condition.
        force: drive force at the wheels, all together [N].
        brake: brake force at the wheels, all together [N], >= 0.
        target: speed to hold by proportional control [m/s]; None drives by `force`.
        tilt: of the ground, uphill along world x [rad].
        locked_axle: the wheels of the driven axle turn as one (no differential).
        stiffness: factors on the cornering stiffness, front and rear.
    """

    params: VehicleParameters
    duration: float
    heading: float = 0.0
    speed: float = 0.0
    steering: Signal = 0.0
    force: Signal = 0.0
    brake: Signal = 0.0
    target: Signal | None = None
    tilt: Signal = 0.0
    locked_axle: bool = False
    stiffness: tuple[float, float] = (1.0, 1.0)

    def signals(self, dt: float) -> np.ndarray:
        """(T, 6) steering, force, brake, target, gain [N s/m], tilt per substep."""
        time = np.arange(round(self.duration / dt)) * dt
        hold = self.target is not None
        values: list[Signal] = [
            self.steering,
            self.force,
            self.brake,
            self.target if self.target is not None else 0.0,
            SPEED_GAIN * self.params.mass if hold else 0.0,
            self.tilt,
        ]
        columns = [v(time) if callable(v) else np.full(len(time), v) for v in values]
        return np.stack(columns, axis=-1)

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """`qpos` (13,) and `qvel` (12,) of the rolling car, rear axle in the origin."""
        qpos, qvel = np.zeros(13), np.zeros(12)
        qpos[3], qpos[6] = math.cos(self.heading / 2), math.sin(self.heading / 2)
        qvel[:2] = self.speed * np.array(
            [math.cos(self.heading), math.sin(self.heading)]
        )
        qvel[INDEX.spin_dof] = self.speed / self.params.wheel_radius
        return qpos, qvel


def gravity_of(tilt: np.ndarray) -> np.ndarray:
    """Gravity (..., 3) [m/s^2] over ground that rises along x by an angle [rad]."""
    tilt = np.asarray(tilt, float)
    zero = np.zeros_like(tilt)
    return -GRAVITY * np.stack([np.sin(tilt), zero, np.cos(tilt)], axis=-1)


def step(final: float, start: float) -> Signal:
    """Zero until `start` [s], then `final`."""
    return lambda time: np.where(time < start - 1e-9, 0.0, final)


def ramp(final: float, start: float, rise: float) -> Signal:
    """Zero until `start` [s], then linearly to `final` within `rise` [s]."""
    return lambda time: final * np.clip((time - start) / rise, 0.0, 1.0)


def _index() -> CarIndex:
    return CarIndex(car_model(COMPACT, 0.01, (0.0, 0.0, -GRAVITY)))


INDEX = _index()
