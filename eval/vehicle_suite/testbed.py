"""Runs of a test driver on brush tyres, and the tracks recorded of them.

The driver's inputs act at once: no pedal, rate limit or speed limiter stands between
the standard's manoeuvre and the car.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from carpark_mj.physics.coordinates import (
    CarIndex,
    column,
    dot,
    init_tyres,
    pack_coordinates,
    pack_tyres,
    unpack_coordinates,
    unpack_tyres,
)
from carpark_mj.physics.forces import roll
from carpark_mj.physics.newton_euler import advance, mass_properties
from carpark_mj.precision import full_float32
from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import WheelTorques, ackermann
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.vehicle import wheels_of

Signal = float | Callable[[np.ndarray], np.ndarray]  # a constant, or of time (T,) [s]

DT = 0.01  # s, the substep of training
LOCKING = 20.0  # g, a brake force over the weight that locks every wheel at once
SPEED_GAIN = 3.0  # 1/s, acceleration per speed error of the test driver
HOLD_LIMIT = 0.3  # g, the most that holding a speed may ask for
CHUNK = 100  # substeps of one call of the compiled program
WIDTH = 16  # cars of one call; fewer are filled up
INDEX = CarIndex(car_model(COMPACT, DT, (0.0, 0.0, -GRAVITY)))


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
    tilt: float = 0.0
    stiffness: tuple[float, float] = (1.0, 1.0)

    def signals(self, dt: float) -> np.ndarray:
        """(T, 5) steering, force, brake, target and gain [N s/m] per substep."""
        time = np.arange(round(self.duration / dt)) * dt
        target, gain = self.target, SPEED_GAIN * self.params.mass
        hold = (0.0, 0.0) if target is None else (target, gain)
        values = [self.steering, self.force, self.brake, *hold]
        columns = [v(time) if callable(v) else np.full(len(time), v) for v in values]
        return np.stack(columns, axis=-1)

    @property
    def gravity(self) -> np.ndarray:
        """(3,) [m/s^2]."""
        return -GRAVITY * np.array([math.sin(self.tilt), 0.0, math.cos(self.tilt)])

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """`qpos` (13,) and `qvel` (12,) of the rolling car, rear axle in the origin."""
        qpos, qvel = np.zeros(13), np.zeros(12)
        qpos[3], qpos[6] = math.cos(self.heading / 2), math.sin(self.heading / 2)
        ahead = np.array([math.cos(self.heading), math.sin(self.heading)])
        qvel[:2] = self.speed * ahead
        qvel[INDEX.spin_dof] = self.speed / self.params.wheel_radius
        return qpos, qvel


def ramp(final: float, start: float, rise: float) -> Signal:
    """Zero until `start` [s], then linearly to `final` within `rise` [s]."""
    return lambda time: final * np.clip((time - start) / rise, 0.0, 1.0)


class Track:
    """A recorded run; row i is the state after i substeps, loads act during row i.

    Attributes:
        run, params, dt: its inputs, the car and the substep [s].
        time: (T + 1,) [s].
        qpos, qvel: (T + 1, 13) and (T + 1, 12), rear axle at the root.
        load, drive: (T, 4) vertical loads [N] and drive torques [N m] of the wheels.
        position, yaw: (T + 1, 2) [m] and (T + 1,) [rad] of the rear axle, unwrapped.
        speed, yaw_rate: (T + 1,) forward [m/s], [rad/s].
        cg, cg_velocity: (T + 1, 3) of the centre of gravity [m], [m/s], world frame.
    """

    def __init__(self, run: Run, dt: float, *motion: np.ndarray) -> None:
        """Works out motions from what was recorded: `qpos`, `qvel`, `load`, `drive`."""
        self.run, self.params, self.dt = run, run.params, dt
        self.qpos, self.qvel, self.load, self.drive = qpos, qvel, *_ = motion
        self.time = np.arange(len(qpos)) * dt
        w, x, y, z = qpos[:, 3:7].T
        yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        self.position, self.yaw, self.yaw_rate = qpos[:, :2], np.unwrap(yaw), qvel[:, 5]
        self.speed = qvel[:, 0] * np.cos(yaw) + qvel[:, 1] * np.sin(yaw)
        rotation = Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
        cg_b = np.array([run.params.cg_to_rear_axle, 0.0, run.params.cg_height])
        self.cg = qpos[:, :3] + rotation.apply(cg_b)
        turning = rotation.apply(np.cross(qvel[:, 3:6], cg_b))
        self.cg_velocity = qvel[:, :3] + turning

    @property
    def steering(self) -> np.ndarray:
        """(T + 1,) bicycle angle of the mean cotangent of the front wheels' [rad]."""
        tan = np.tan(self.qpos[:, INDEX.steer_qpos])
        total, out = tan.sum(1), np.zeros(len(tan))
        turned = np.abs(total) >= 1e-12
        return np.arctan(np.divide(2 * tan.prod(1), total, out=out, where=turned))

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

    def distance(self, first: int) -> float:
        """Straight distance of the rear-axle centre from a row to the end [m]."""
        return float(np.linalg.norm(self.position[-1] - self.position[first]))


def circle_radius(path: np.ndarray) -> float:
    """Radius of the circle that fits points (T, 2) best (Kasa's linear fit)."""
    path = path - path.mean(0)
    rows = np.column_stack([2 * path, np.ones(len(path))])
    (x, y, c), *_ = np.linalg.lstsq(rows, (path**2).sum(1), rcond=None)
    return math.sqrt(c + x**2 + y**2)


def tracks_of(runs: Sequence[Run], dt: float = DT, x64: bool = False) -> list[Track]:
    """Drives the runs in MJX in substeps `dt` [s], `WIDTH` at a time."""
    groups = (runs[i : i + WIDTH] for i in range(0, len(runs), WIDTH))
    with jax.enable_x64(x64):
        return [track for group in groups for track in _drive(group, dt, x64)]


def _drive(runs: Sequence[Run], dt: float, x64: bool) -> list[Track]:
    cars = [*runs, *[runs[-1]] * (WIDTH - len(runs))]
    signals = [run.signals(dt) for run in cars]
    length = -(-max(map(len, signals)) // CHUNK) * CHUNK
    instants = np.arange(length)
    table = np.stack([s[np.minimum(instants, len(s) - 1)] for s in signals], 1)
    dtype = jnp.result_type(float)
    starts = [np.stack(x) for x in zip(*(r.start() for r in cars), strict=True)]
    vehicles = jax.tree.map(lambda *x: jnp.stack(x), *map(vehicle_of, cars))
    bristles = init_tyres(WIDTH, dtype=dtype)
    qpos, qvel = (jnp.array(x, dtype) for x in starts)
    carry, rows = (qpos, qvel, bristles), []
    fixed = vehicles, jnp.array([run.gravity for run in cars], dtype)
    for part in np.split(table, length // CHUNK):
        inputs = jnp.array(part, dtype), dtype.type(dt)
        carry, seen = _program(x64)(carry, *fixed, *inputs)
        rows.append(jax.device_get(seen))
    seen = [np.concatenate(x).astype(float) for x in zip(*rows, strict=True)]
    for k, start in enumerate(starts):  # of the states, which have one row more
        seen[k] = np.concatenate([start[None], seen[k]])
    ends = [len(s) for s in signals]
    return [
        Track(run, dt, *(x[: ends[i] + (k < 2), i] for k, x in enumerate(seen)))
        for i, run in enumerate(runs)
    ]


@functools.cache
def _program(x64: bool):
    """Compiles `CHUNK` substeps of `WIDTH` cars; call it with x64 switched to match."""
    del x64  # a key of the cache

    def substep(carry, vehicle: Vehicle, gravity, signal, dt):
        qpos, qvel, tyres = carry
        at = unpack_coordinates(INDEX, qpos, qvel)
        ahead = dot(column(at.rotation, 0), at.velocity)
        ctrl, drive, brake = controls(vehicle, signal, ahead)
        torques = [WheelTorques(*pair) for pair in zip(drive, brake, strict=True)]
        wheels, bristles = wheels_of(vehicle), unpack_tyres(tyres)
        forces, bristles = roll(wheels, at, bristles, torques, dt)
        masses, tyres = mass_properties(vehicle), pack_tyres(bristles)
        at = advance(masses, at, forces, tuple(ctrl), tuple(gravity), dt)
        qpos, qvel = pack_coordinates(INDEX, at)
        return (qpos, qvel, tyres), (qpos, qvel, jnp.stack(forces.load), drive)

    batched = jax.vmap(substep, in_axes=(0, 0, 0, 0, None))

    @jax.jit
    @full_float32
    def run(carry, vehicles, gravity, signals, dt):
        def step(carry, signal):
            return batched(carry, vehicles, gravity, signal, dt)

        return jax.lax.scan(step, carry, signals)

    return run


def controls(
    vehicle: Vehicle, signal: jax.Array, speed: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Servo targets (2,) [rad], drive and brake torques (4,) [N m] of the test driver.

    `signal` (5,) is a row of `Run.signals`, the speed is along the car [m/s].
    """
    steering, force, brake, target, gain = signal
    limit, radius = HOLD_LIMIT * GRAVITY * vehicle.mass, vehicle.wheel_radius
    force = force + jnp.clip(gain * (target - speed), -limit, limit)
    drive = force * radius * vehicle.drive_share
    front = jnp.stack(ackermann(vehicle, steering))
    return front, drive, brake * radius * vehicle.brake_share


def vehicle_of(run: Run) -> Vehicle:
    """The run's car with its factors on the cornering stiffness."""
    vehicle = make_vehicle(run.params)
    factors = jnp.repeat(jnp.array(run.stiffness), 2)
    stiffness = vehicle.tyres.lateral_stiffness * factors
    tyres = dataclasses.replace(vehicle.tyres, lateral_stiffness=stiffness)
    return dataclasses.replace(vehicle, tyres=tyres)
