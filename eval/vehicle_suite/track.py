"""Runs, the inputs of a test driver, and tracks, the motion recorded of a run.

Inputs act at once: no pedal, no rate limit and no speed limiter stands between the
standard's manoeuvre and the car.
"""

import dataclasses
import math
from collections.abc import Callable

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

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
        target, gain = self.target, SPEED_GAIN * self.params.mass
        hold = (0.0, 0.0) if target is None else (target, gain)
        values = [self.steering, self.force, self.brake, *hold, self.tilt]
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


INDEX = CarIndex(car_model(COMPACT, 0.01, (0.0, 0.0, -GRAVITY)))


class Track:
    """A recorded run; row i is the state after i substeps, loads act during row i.

    Attributes:
        run, params, dt: its inputs, the car and the substep [s].
        time: (T + 1,) [s].
        qpos, qvel: (T + 1, 13) and (T + 1, 12), rear axle at the root.
        load, drive: (T, 4) vertical loads [N] and drive torques [N m] of the wheels.
        position, yaw: (T + 1, 2) [m] and (T + 1,) [rad] of the rear axle, unwrapped.
        speed, yaw_rate: (T + 1,) forward [m/s], [rad/s].
        spin: (T + 1, 4) [rad/s].
        wheel_angles: (T + 1, 2) of the front wheels about their kingpins [rad].
        steering: (T + 1,) bicycle angle [rad] that the two have: mean cotangent.
        rotation: (T + 1, 3, 3) body to world.
        cg, cg_velocity: (T + 1, 3) of the centre of gravity [m], [m/s], world frame.
    """

    def __init__(
        self,
        run: Run,
        dt: float,
        qpos: np.ndarray,
        qvel: np.ndarray,
        load: np.ndarray,
        drive: np.ndarray,
    ) -> None:
        """Works out motions from what was recorded."""
        self.run, self.params, self.dt = run, run.params, dt
        self.qpos, self.qvel, self.load, self.drive = qpos, qvel, load, drive
        self.time = np.arange(len(qpos)) * dt
        w, x, y, z = qpos[:, 3:7].T
        yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        self.position, self.yaw, self.yaw_rate = qpos[:, :2], np.unwrap(yaw), qvel[:, 5]
        self.speed = qvel[:, 0] * np.cos(yaw) + qvel[:, 1] * np.sin(yaw)
        self.spin = qvel[:, INDEX.spin_dof]
        self.wheel_angles = qpos[:, INDEX.steer_qpos]
        tan = np.tan(self.wheel_angles)
        total = tan.sum(1)
        safe = np.where(np.abs(total) < 1e-12, 1.0, total)
        self.steering = np.arctan(np.where(total == safe, 2 * tan.prod(1) / safe, 0.0))
        quat = qpos[:, 3:7]
        self.rotation = Rotation.from_quat(quat, scalar_first=True).as_matrix()
        cg_b = np.array([run.params.cg_to_rear_axle, 0.0, run.params.cg_height])
        self.cg = qpos[:, :3] + self.rotation @ cg_b
        turning = np.cross(qvel[:, 3:6], cg_b)
        turning = np.einsum("tij,tj->ti", self.rotation, turning)
        self.cg_velocity = qvel[:, :3] + turning

    @property
    def lateral_acceleration(self) -> np.ndarray:
        """(T + 1,) of the centre of gravity, square to its course [m/s^2]."""
        x, y, _ = self.cg_velocity.T
        course = np.unwrap(np.arctan2(y, x))
        return np.hypot(x, y) * np.gradient(course, self.dt)

    def at(self, seconds: float) -> int:
        """Index of an instant."""
        return round(seconds / self.dt)

    def late(self, values: np.ndarray, seconds: float) -> float:
        """Mean of values (T or T + 1,) over the last seconds."""
        return float(values[-self.at(seconds) :].mean())

    def trend(self, values: np.ndarray, first: float, last: float) -> float:
        """Slope [1/s] of values (T + 1,) between two instants."""
        rows = slice(self.at(first), self.at(last) + 1)
        return float(np.polyfit(self.time[rows], values[rows], 1)[0])

    def distance(self, first: int = 0, last: int = -1) -> float:
        """Straight distance of the rear-axle centre between two rows [m]."""
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
    """Abscissa at which y first reaches a level from below; NaN if never."""
    above = y >= level
    if not above.any():
        return math.nan
    i = int(np.argmax(above))
    return float(
        x[i] if i == 0 else np.interp(level, y[i - 1 : i + 1], x[i - 1 : i + 1])
    )
