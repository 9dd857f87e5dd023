"""Simulates a test drive in pieces, for many cars that differ in what is sought.

A piece begins `WARM_UP` before its measurements, with the steering where the log has
it, in a steady turn. Its start is sought too, so that errors do not add up over the
drive: noise of the pedal, a slope, wind. Pieces begin where the car is fast, for what
brakes and drive do next to standstill depends on how it came there; where it stops and
stands nothing is compared, and the next piece begins at rest.
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.identification.log import POSE, RATES, DriveLog
from carpark_mj.physics.coordinates import Car, Coordinates, TyreState
from carpark_mj.physics.forces import drive_car
from carpark_mj.physics.newton_euler import advance, mass_properties
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import WHEELS
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.vehicle import Vehicle, make_vehicle, wheels_of

SIM_DT = 0.0025  # s; at 0.01 the tyres would seem a tenth softer than they are
WARM_UP = 1.0  # s, in which tyres and brakes forget how they began
PIECE = 5.0  # s
STOP = 1.0  # rad, the steering's of a car whose steering wheel is measured
STAND = 0.5  # s, what is slow for so long stops or stands
REST = 0.15  # m/s, what is slower at the beginning of a piece stands
FREE = 1e3  # m/s or rad/s, beyond every limit


class Sought(NamedTuple):
    """Parameters sought: numbers, or arrays of one shape."""

    steering_delay: Any  # s, from the log's steering to the wheels' servo
    pedal_delay: Any  # s, from the log's pedal to drive and brake
    steering_ratio: Any  # the log's steering angle over that of the road wheels
    steering_offset: Any  # rad, angle of the road wheels where the log has 0
    cornering_stiffness: Any  # 1/rad, of the tyres, per load
    max_acceleration: Any  # m/s^2, drive at full pedal
    max_deceleration: Any  # m/s^2, brake at full pedal
    rolling_resistance: Any  # of the tyres, force per load
    drive_lag: Any  # s, time constant of the drive torque
    lateral_relaxation: Any  # m, relaxation length of the tyres' lateral force
    patch_radius: Any  # m, of the tyres, as their scrub torque has it


class Recording(NamedTuple):
    """A log in pieces, as the simulation needs it."""

    time: np.ndarray  # (n,) s, of the commands
    steering: np.ndarray  # (n,) rad
    pedal: np.ndarray  # (n,) in [-1, 1]
    begin: np.ndarray  # (pieces,) s, when the simulation of a piece begins
    piece: np.ndarray  # (n,) of a row, for its measurements
    moment: np.ndarray  # (n,) s, of that row, after the piece began


class Replay:
    """Simulates the cars of a log; `recording` is the log in pieces.

    Quantities `measured` (channels, n) are named by `channels`, NaN where nothing is;
    `own` is what is sought, as the vehicle has it, and `starts` (pieces, 4) are x, y,
    yaw and speed with which the pieces begin, by the log.
    """

    def __init__(
        self,
        log: DriveLog,
        params: VehicleParameters,
        ahead: float,
        sim_dt: float = SIM_DT,
    ) -> None:
        """Cuts the log; the arguments are those of `fit.identify`."""
        self.channels = tuple(n for n in (*POSE, *RATES) if n in log.measured)
        wheel = log.names[0] == "steering_wheel"
        pedal, full = _pedal(log, params)
        self._vehicle = _test_car(params, wheel)
        own = {"steering_delay": 0.0, "pedal_delay": 0.0, "steering_offset": 0.0}
        own |= {"steering_ratio": 15.0 if wheel else 1.0}
        own |= vars(params) | vars(params.tyre)
        self.own = Sought(*(own[name] for name in Sought._fields))
        self._scale = (
            full[0] / self.own.max_acceleration,
            full[1] / self.own.max_deceleration,
        )
        stands = _stands(log.time, log.speed)
        begin, piece = _pieces(log.time, np.abs(log.speed), stands)
        unmeasured = piece < 0
        self.recording = Recording(
            log.time - log.time[0],
            log.steering,
            _released(pedal, log.speed, stands),
            begin - log.time[0],
            np.maximum(piece, 0),
            np.where(unmeasured, 0.0, log.time - begin[piece]),
        )
        measured = np.stack([log.measured[name] for name in self.channels])
        self.measured = np.where(unmeasured, np.nan, measured)
        self._ahead, self._sim_dt = ahead, sim_dt
        x, y, yaw = (
            log.at(name, begin) if name in self.channels else np.zeros_like(begin)
            for name in POSE
        )
        x, y = x - ahead * np.cos(yaw), y - ahead * np.sin(yaw)
        speed = np.interp(begin, log.time, log.speed)
        speed = np.where(abs(speed) < REST, 0.0, speed)
        self.starts = np.stack([x, y, yaw, speed], axis=-1)
        # In whole seconds, so that logs of one length share a compiled program.
        self._steps = round(np.ceil(self.recording.moment.max() + 0.1) / sim_dt)

    def simulate(self, sought: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """What would be measured (cars, channels, n).

        Of `sought` (cars, p) in the order of `Sought`, and `starts` (cars, pieces, 4).
        """
        with jax.enable_x64(True):
            columns = Sought(*(jnp.asarray(x)[:, None] for x in sought.T))
            scaled = columns._replace(
                max_acceleration=columns.max_acceleration * self._scale[0],
                max_deceleration=columns.max_deceleration * self._scale[1],
                patch_radius=columns.patch_radius / self.own.patch_radius,
            )
            how = self._ahead, self._sim_dt, self._steps
            seen = _simulate(self._vehicle, self.recording, scaled, starts, *how)
            return np.stack([np.asarray(seen[name]) for name in self.channels], axis=1)


def _runs(there: np.ndarray) -> list[list[int]]:
    """First rows of the runs of a mask (n,), and the rows after them."""
    edges = np.flatnonzero(np.diff(there, prepend=False, append=False))
    return edges.reshape(-1, 2).tolist()


def _stands(time: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Where the car is about to stop or stands (n,), for at least `STAND`."""
    slow = np.abs(speed) < drive.HOLD_SPEED
    for first, after in _runs(slow):
        if time[after - 1] - time[first] < STAND:
            slow[first:after] = False
    return slow


def _pieces(
    time: np.ndarray, speed: np.ndarray, stands: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """When the simulations of pieces begin (pieces,) [s], and rows' pieces (n,).

    A piece begins at rest or else where the car is fast. Rows of piece -1 are not
    compared: before the end of a warm-up, and where the car stands.
    """
    begin, piece = [], np.full(len(time), -1)
    for first, after in _runs(~stands):
        end, begins, rows = time[after - 1], time[first], np.arange(first, after)
        if first > 0:  # at rest, a warm-up before it moves or as long as it stood
            before = (time >= begins - WARM_UP) & (time < begins) & stands
            slowest = max(REST, speed[before].min())
            measured, begins = begins, time[before & (speed <= slowest)][0]
        else:
            measured = begins + WARM_UP
        if end - measured < WARM_UP:
            continue
        begin.append(begins)
        piece[rows[time[rows] >= measured]] = len(begin) - 1
        count = max(round(float(end - measured) / PIECE), 1)
        for middle in np.linspace(measured, end, count, endpoint=False)[1:]:
            latest = min(middle + PIECE / 2, end - 2 * WARM_UP)
            near = (time >= middle) & (time <= latest)
            begin.append(time[near][speed[near].argmax()])
            piece[rows[time[rows] >= begin[-1] + WARM_UP]] = len(begin) - 1
    if not begin:
        raise ValueError(f"the car must move for at least {2 * WARM_UP:g} s on end")
    return np.array(begin), piece


def _released(pedal: np.ndarray, speed: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """The pedal (n,) less the brake of a car that stands, which would drive it back."""
    moving = np.flatnonzero(~stands)
    after = np.searchsorted(moving, np.arange(len(pedal))).clip(max=len(moving) - 1)
    return np.where(stands & (pedal * speed[moving[after]] < 0), 0.0, pedal)


def _pedal(
    log: DriveLog, params: VehicleParameters
) -> tuple[np.ndarray, tuple[float, float]]:
    """The pedal (n,) of a log, and what 1 stands for, driving and braking [m/s^2].

    Of accelerations it is by the way the car moves.
    """
    full = params.max_acceleration, params.max_deceleration
    if log.names[1] == "pedal":
        return log.pedal, full
    asked, brakes = np.abs(log.pedal), log.pedal * log.speed < 0
    full = (
        max(full[0], asked[~brakes].max(initial=0.0)),
        max(full[1], asked[brakes].max(initial=0.0)),
    )
    return log.pedal / np.where(brakes, full[1], full[0]), full


def _test_car(params: VehicleParameters, wheel: bool) -> Vehicle:
    """The car without limits of its speed, which a driver does not have.

    Where the steering wheel was measured the limits of the steering lie before it.
    """
    with jax.enable_x64(True):
        vehicle = make_vehicle(params)
        free = jnp.asarray(FREE)
        vehicle = dataclasses.replace(vehicle, max_speed=free, max_reverse_speed=free)
        if wheel:
            vehicle = dataclasses.replace(
                vehicle,
                steering_rate=free,
                steering_lag=jnp.zeros_like(vehicle.steering_lag),
                max_steering=jnp.asarray(STOP),
            )
        return vehicle


@partial(jax.jit, static_argnames="steps")
def _simulate(
    vehicle: Vehicle,
    recording: Recording,
    sought: Sought,
    starts: jax.Array,
    ahead: float,
    sim_dt: float,
    steps: int,
) -> dict[str, jax.Array]:
    tyres = vehicle.tyres
    stiffness = (sought.cornering_stiffness / sought.lateral_relaxation)[..., None]
    tyres = dataclasses.replace(
        tyres,
        rolling_resistance=sought.rolling_resistance,
        lateral_relaxation=sought.lateral_relaxation,
        lateral_stiffness=stiffness * tyres.static_load,
        torsion_stiffness=sought.patch_radius[..., None] * tyres.torsion_stiffness,
    )
    own = ("steering_offset", "max_acceleration", "max_deceleration", "drive_lag")
    changes = {name: getattr(sought, name) for name in own}
    vehicle = dataclasses.replace(vehicle, tyres=tyres, **changes)
    wheels, masses = wheels_of(vehicle), mass_properties(vehicle)
    clock = recording.begin + sim_dt * jnp.arange(steps)[:, None, None]
    steer = jnp.interp(
        clock - sought.steering_delay, recording.time, recording.steering
    ) / (sought.steering_ratio * vehicle.max_steering)
    pedal = jnp.interp(clock - sought.pedal_delay, recording.time, recording.pedal)
    gravity = jnp.zeros(()), jnp.zeros(()), jnp.asarray(-GRAVITY)

    def substep(
        car: Car, controls: tuple[jax.Array, jax.Array]
    ) -> tuple[Car, dict[str, jax.Array]]:
        forces, targets, bristles, actuators = drive_car(
            vehicle, wheels, car, controls, sim_dt
        )
        at = advance(masses, car.coordinates, forces, targets, gravity, sim_dt)
        return Car(at, bristles, actuators), _seen(car.coordinates, ahead)

    _, seen = jax.lax.scan(
        substep,
        _start(vehicle, sought.cornering_stiffness, starts, steer[0]),
        (steer, pedal),
    )
    seen["yaw"] = jnp.unwrap(seen["yaw"], axis=0)
    step = recording.moment / sim_dt
    before = jnp.minimum(step.astype(int), steps - 2)
    share = step - before

    def at_rows(values: jax.Array) -> jax.Array:
        first, second = (values[before + k, :, recording.piece] for k in (0, 1))
        return (first * (1 - share[:, None]) + second * share[:, None]).T

    return {name: at_rows(values) for name, values in seen.items()}


def _start(
    vehicle: Vehicle, stiffness: jax.Array, starts: jax.Array, steer: jax.Array
) -> Car:
    """Cars (cars, pieces) in steady turns from starts (cars, pieces, 4)."""
    x, y, yaw, speed = (starts[..., k] for k in range(4))
    zero = jnp.zeros_like(x)
    stands = jnp.abs(speed[:1]) < REST / 2
    speed = jnp.where(stands, 0.0, speed)
    hold = jnp.where(stands, vehicle.hold_deceleration, zero)
    steering = jnp.clip(steer, -1.0, 1.0) * vehicle.max_steering
    angle = steering + vehicle.steering_offset
    spin, (cos, sin) = speed / vehicle.wheel_radius, (jnp.cos(yaw), jnp.sin(yaw))
    yaw_rate = speed * jnp.tan(angle) / vehicle.wheelbase
    # Stiffness per load and slip angle are equal at all wheels.
    slip = speed * yaw_rate / (GRAVITY * stiffness) + zero
    drift = -jnp.abs(speed) * slip
    at = Coordinates(
        position=(x, y, zero),
        quaternion=(jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)),
        steer=drive.ackermann(vehicle, angle),
        angle=(zero,) * len(WHEELS),
        velocity=(speed * cos - drift * sin, speed * sin + drift * cos, zero),
        angular=(zero, zero, yaw_rate),
        steer_rate=(zero, zero),
        spin=(spin,) * len(WHEELS),
    )
    bristle = -vehicle.tyres.lateral_relaxation * slip
    tyres = (TyreState(zero, bristle, zero),) * len(WHEELS)
    return Car(at, tyres, drive.Actuators(steering=steering, drive=zero, hold=hold))


def _seen(at: Coordinates, ahead: float) -> dict[str, jax.Array]:
    """What sensors of cars see, the position of a point ahead of the rear axle."""
    w, x, y, z = at.quaternion
    yaw = jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    along = jnp.cos(yaw), jnp.sin(yaw)
    return {
        "x": at.position[0] + ahead * along[0],
        "y": at.position[1] + ahead * along[1],
        "yaw": yaw,
        "speed": at.velocity[0] * along[0] + at.velocity[1] * along[1],
        "yaw_rate": at.angular[2],
    }
