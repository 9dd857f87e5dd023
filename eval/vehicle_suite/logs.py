"""Logs of test drives with known parameters and noise of sensors.

Most cars are driven in C MuJoCo. The kinds `stops` and `rolling` drive a single-track
car in NumPy, which shares no code with the library: its lateral tyre forces follow
their slip angles with a relaxation length, drive and road wheels follow pedal and
steering wheel with lags, and it stands where the brakes have stopped it.
"""

import dataclasses
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.identification.log import POSE, DriveLog
from carpark_mj.identification.simulation import Sought
from carpark_mj.vehicle.drive import ackermann
from carpark_mj.vehicle.parameters import VehicleParameters
from vehicle_suite.shipped import CCar

DriveName = Literal["full", "circle", "stops", "rolling"]
SINGLE_TRACK = "stops", "rolling"
CYCLE = 10.0  # s: start, hold, brake, stand
# Standard deviations of satellites with corrections.
NOISE = {"x": 0.02, "y": 0.02, "yaw": 0.003}
LOG_DT = 0.02  # s
# Times (n,) [s], angles of the steering wheel (n,) [rad], pedal (n,).
Commands = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Drive:
    """A drive to record: true parameters of a car, which otherwise equals a preset.

    The seed is of the driver's amplitudes and the noise.
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

    def commands(self) -> Commands:
        """What the driver does."""
        dice = np.random.default_rng(self.seed)
        time = np.arange(0, self.seconds, self.sim_dt)
        phase, (wide, fast) = dice.uniform(0, 6), dice.uniform([0.3, 0.1], [0.4, 0.2])
        angle = wide * np.sin(0.5 * time + phase) + fast * np.sin(1.7 * time)
        drive, brake = dice.uniform([0.5, 0.3], [0.65, 0.45])
        if self.kind == "circle":
            angle[:] = 0.4
        moment = time % CYCLE
        pedal = drive * ((moment > 0.5) & (moment < 3.5))
        pedal += 0.1 * ((moment >= 3.5) & (moment < 6.0))
        pedal -= brake * ((moment > 6.0) & (moment < 9.0))
        width = round(0.3 / self.sim_dt)
        pedal = np.convolve(pedal, np.full(width, 1 / width), "same")
        return time, angle * float(self.true.steering_ratio), pedal


def record(drive: Drive) -> DriveLog:
    """The log of a drive, with poses."""
    if drive.kind in SINGLE_TRACK:
        dice = np.random.default_rng(drive.seed)
        commands, path = _drive_single_track(drive, dice)
    else:
        commands, dice = drive.commands(), np.random.default_rng([drive.seed, 1])
        path = _drive_in_c(drive, *commands)
    every = round(LOG_DT / commands[0][1])
    time, wheel, pedal = (values[::every] for values in commands)
    rows = {
        name: values[::every] + dice.normal(0.0, NOISE[name], len(time))
        for name, values in zip(POSE, path.T, strict=False)
    }
    return DriveLog(time, wheel, pedal, ("steering_wheel", "pedal"), rows)


def _drive_in_c(
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
            path.append(car.motion)
            car.step(controls)
    motion = np.array(path)
    motion[:, 2] = np.unwrap(motion[:, 2])
    return motion


G = 9.81  # m/s^2
SLOW = 0.5  # m/s, below it the wheels roll without slip
# The single-track car, in all else as the drive's. SI units.
DT = 0.001  # of its integration
STEERING_LAG = 0.014  # as of our steering servo
ARM = 1.277  # radius of gyration about the vertical
ROTATING = 0.029  # what the wheels' inertia adds to the mass, a share of it


def _drive_single_track(
    drive: Drive, dice: np.random.Generator
) -> tuple[Commands, np.ndarray]:
    """Commands and the motion (n, 5) of the rear axle between 1 and 4 m/s, in curves.

    It drives, coasts and brakes in turn, and moves the pedal gradually. The brakes of
    `stops` stop it in every cycle, and the foot stays on them. Shares of `front_drive`
    and `front_brake` act along the steered wheels, the rest along the car.
    """
    true, params = drive.true, drive.params
    time = np.arange(0, drive.seconds, DT)
    phases, (wide, fast) = dice.uniform(0, 6, 2), dice.uniform([0.2, 0.1], [0.3, 0.15])
    angle = wide * np.sin(0.5 * time + phases[0]) + fast * np.sin(2 * time + phases[1])
    steer = np.interp(time - true.steering_delay, time, angle)
    late, pedals = round(true.pedal_delay / DT), np.zeros(len(time))
    front, rear = params.cg_to_front_axle, params.cg_to_rear_axle
    loads = G * np.array([rear, front]) / params.wheelbase  # per mass
    stiff = true.cornering_stiffness * loads
    drives, brakes = (
        np.array([share, 1 - share])
        for share in (params.front_drive, params.front_brake)
    )
    x = y = yaw = v = across = rate = pull = pedal = aim = 0.0
    slow, until, phase, enough = float(drive.kind == "rolling"), 0.5, 0, 0.0
    slips, delta, out = np.zeros(2), steer[0], []
    for k, wanted in enumerate(steer):
        done = time[k] >= until
        if phase == 1:
            done = v > enough
        elif phase == 3 and v > slow:
            done, until = False, time[k] + (0.0 if slow else 1.0)
        if done:
            phase = (phase + 1) % 4
            until, enough = time[k] + dice.uniform(0.5, 1.5), dice.uniform(2.5, 4.0)
            gas, brake = dice.uniform([0.4, 0.25], [0.8, 0.5])
            aim = (0.0, gas, 0.0, -brake)[phase]
        pedals[k] = pedal = pedal + np.clip(aim - pedal, -4 * DT, 4 * DT)
        p = pedals[k - late] if k >= late else 0.0
        delta = _lagged(delta, wanted, STEERING_LAG)
        turned = delta + true.steering_offset
        pull = _lagged(pull, max(p, 0.0) * true.max_acceleration, true.drive_lag)
        brake = max(-p, 0.0) * true.max_deceleration
        ends = np.array([across + front * rate, across - rear * rate])
        aims = np.arctan2(ends, max(v, 0.1)) - [turned, 0.0]
        slips += DT * max(v, 0.1) / true.lateral_relaxation * (aims - slips)
        force = -stiff * slips
        resists = brake * brakes + true.rolling_resistance * loads
        along = pull * drives - resists * (v > 0 or pull > resists.sum())
        sin, cos = np.sin(turned), np.cos(turned)
        push = along[0] * cos + along[1] - force[0] * sin
        v = max(v + DT * (push / (1 + ROTATING) + across * rate), 0.0)
        if v < SLOW:
            rate = v * np.tan(turned) / params.wheelbase
            across = rear * rate
            slips[:] = 0.0
        else:
            ahead = force[0] * cos + along[0] * sin
            across += DT * (ahead + force[1] - v * rate)
            rate += DT * (front * ahead - rear * force[1]) / ARM**2
        out.append((x, y, yaw, v, rate))
        left = across - rear * rate
        x += DT * (v * np.cos(yaw) - left * np.sin(yaw))
        y += DT * (v * np.sin(yaw) + left * np.cos(yaw))
        yaw += DT * rate
    return (time, angle * true.steering_ratio, pedals), np.array(out)


def _lagged(value: float, target: float, lag: float) -> float:
    return target + (value - target) * np.exp(-DT / lag) if lag > 0 else target
