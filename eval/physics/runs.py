"""What a test driver does (`Run`) and what the car did (`Track`).

A run gives signals over time: steering angle, drive and brake force at the wheels, a
speed to hold, the tilt of the ground. They act at once: no pedal, no rate limit and no
speed limiter stands between the standard's manoeuvre and the car.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import cached_property

import mujoco
import numpy as np

from carpark_mj.physics.mjx import CarIndex
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters

Signal = float | Callable[[np.ndarray], np.ndarray]  # a constant, or of time (T,) [s]

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


@dataclasses.dataclass(frozen=True)
class Track:
    """What a car did; row i is the state after i substeps, loads act during row i.

    Attributes:
        run: what it was asked.
        dt: substep [s].
        qpos: (T + 1, 13) positions, rear axle at the root.
        qvel: (T + 1, 12) velocities.
        load: (T, 4) vertical wheel loads [N].
        drive: (T, 4) drive torque at the wheels [N m].
    """

    run: Run
    dt: float
    qpos: np.ndarray
    qvel: np.ndarray
    load: np.ndarray
    drive: np.ndarray

    @property
    def params(self) -> VehicleParameters:
        """The car."""
        return self.run.params

    @property
    def time(self) -> np.ndarray:
        """(T + 1,) [s]."""
        return np.arange(len(self.qpos)) * self.dt

    def at(self, seconds: float) -> int:
        """Index of an instant."""
        return round(seconds / self.dt)

    @cached_property
    def yaw(self) -> np.ndarray:
        """(T + 1,) [rad], unwrapped."""
        w, x, y, z = self.qpos[:, 3:7].T
        return np.unwrap(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))

    @property
    def position(self) -> np.ndarray:
        """(T + 1, 2) rear-axle centre [m]."""
        return self.qpos[:, :2]

    @cached_property
    def velocity(self) -> np.ndarray:
        """(T + 1, 2) of the rear-axle centre, forward and left on the ground [m/s]."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y = self.qvel[:, 0], self.qvel[:, 1]
        return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)

    @property
    def speed(self) -> np.ndarray:
        """(T + 1,) forward [m/s]."""
        return self.velocity[:, 0]

    @property
    def yaw_rate(self) -> np.ndarray:
        """(T + 1,) [rad/s]."""
        return self.qvel[:, 5]

    @property
    def spin(self) -> np.ndarray:
        """(T + 1, 4) [rad/s]."""
        return self.qvel[:, INDEX.spin_dof]

    @property
    def wheel_angles(self) -> np.ndarray:
        """(T + 1, 2) of the front wheels about their kingpins [rad]."""
        return self.qpos[:, INDEX.steer_qpos]

    @property
    def steering(self) -> np.ndarray:
        """(T + 1,) bicycle angle [rad] that the two wheels have: mean cotangent."""
        tan = np.tan(self.wheel_angles)
        total = tan.sum(1)
        safe = np.where(np.abs(total) < 1e-12, 1.0, total)
        return np.arctan(np.where(total == safe, 2 * tan.prod(1) / safe, 0.0))

    @cached_property
    def course(self) -> tuple[np.ndarray, np.ndarray]:
        """(T + 1,) speed [m/s] and direction [rad] of the centre of gravity."""
        arm = self.params.cg_to_rear_axle * self.yaw_rate
        x = self.qvel[:, 0] - arm * np.sin(self.yaw)
        y = self.qvel[:, 1] + arm * np.cos(self.yaw)
        return np.hypot(x, y), np.unwrap(np.arctan2(y, x))

    @property
    def lateral_acceleration(self) -> np.ndarray:
        """(T + 1,) of the centre of gravity, square to its course [m/s^2]."""
        speed, direction = self.course
        return speed * np.gradient(direction, self.dt)

    def distance(self, first: int = 0, last: int = -1) -> float:
        """Straight distance between two rows [m]."""
        return float(np.linalg.norm(self.position[last] - self.position[first]))

    def kinetic_energy(self, row: int) -> float:
        """Of all bodies [J], by MuJoCo's own mass matrix."""
        model = car_model(self.params, self.dt, (0.0, 0.0, -GRAVITY))
        data = mujoco.MjData(model)
        data.qpos, data.qvel = self.qpos[row], self.qvel[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        return float(data.energy[1])


def circle_radius(path: np.ndarray) -> float:
    """Radius of the circle that fits points (T, 2) best (Kasa's linear fit)."""
    middle = path.mean(0)
    path = path - middle
    rows = np.column_stack([2 * path, np.ones(len(path))])
    (x, y, c), *_ = np.linalg.lstsq(rows, (path**2).sum(1), rcond=None)
    return math.sqrt(c + x**2 + y**2)


def crossing(x: np.ndarray, y: np.ndarray, level: float) -> float:
    """x at which y first reaches a level from below, interpolated; NaN if never."""
    above = y >= level
    if not above.any():
        return math.nan
    i = int(np.argmax(above))
    return float(
        x[i] if i == 0 else np.interp(level, y[i - 1 : i + 1], x[i - 1 : i + 1])
    )


def step(final: float, start: float) -> Signal:
    """Zero until `start` [s], then `final`."""
    return lambda time: np.where(time < start - 1e-9, 0.0, final)


def ramp(final: float, start: float, rise: float) -> Signal:
    """Zero until `start` [s], then linearly to `final` within `rise` [s]."""
    return lambda time: final * np.clip((time - start) / rise, 0.0, 1.0)


def _index() -> CarIndex:
    return CarIndex(car_model(VehicleParameters(), 0.01, (0.0, 0.0, -GRAVITY)))


INDEX = _index()
