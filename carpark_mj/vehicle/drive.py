"""From an action to steering angles and wheel torques.

An action is `[steer, pedal]` in [-1, 1]^2. `steer` commands a road-wheel angle of the
bicycle model, reached at a limited rate and shared between the front wheels by the
Ackermann condition. `pedal` commands an acceleration. Along the motion it drives;
against the motion it brakes; below `SWITCH_SPEED` it drives either way. Pedals below
`HOLD_PEDAL` count as 0.

The holding brake closes where a car slower than `HOLD_SPEED` is not driven along its
motion, and stays closed until the pedal drives the car along its motion: a car that
slides on locked wheels keeps them locked. It opens as soon as the car moves, so that
the shortest drive ends on a hold that closes anew. It closes gradually and eases off as
the car comes to rest, as a driver stops a car: without a jerk, and without rocking on
the tyres. From `SWITCH_SPEED` up, a stronger pedal against the motion always brakes at
least as hard. A released pedal does not close it where `Vehicle.creep` is given: that
car creeps until a pedal against the motion brakes it.

Steering and drive may follow with a first-order lag, and late: commands travel on lines
for a whole number of substeps. All functions are elementwise, for cars of any shape.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.geometry.se2 import finite_slope
from carpark_mj.vehicle.vehicle import Vehicle

SWITCH_SPEED = 0.1  # m/s, below it a pedal against the motion drives the new way
HOLD_PEDAL = 0.05  # pedals smaller than this mean "no pedal"
HOLD_SPEED = 0.3  # m/s, below it the holding brake begins to close
# m/s, above it a pedal along the motion opens the hold. A car let go on a slope rocks
# by less; one that the hold stops at once from less jerks by less than 10 m/s^3.
OPEN_SPEED = 0.012
# The hold's, [est]: no stop rebounds above 0.03 m/s or jerks above 10 m/s^3.
HOLD_TIME = 0.5  # s, in which the closing of the hold becomes e times as fast
HOLD_START = 0.125  # m/s^2 per `HOLD_TIME`, how fast the hold begins to close
HOLD_RAMP = 14.0  # times `Actuators.hold` is what brakes a car that still rolls
HOLD_EASE = 3.0  # m/s^3, the jerk with which the hold brings a car to rest
CREEP_SPEED = 1.7  # m/s, of the driven wheels: 800 rpm of idling through 15:1 [est]
SPINNING = 0.5  # m/s of the driven wheels above the car's speed: they spin
_TINY = 1e-12  # m^2/s^4, keeps the slope of a square root at rest finite

_quotient = finite_slope(jnp.divide)  # by a speed or lag of 0 it is infinite


@struct.dataclass
class Line:
    """Commands of one control on their way to cars (...)."""

    # values (...), the newest first. The last acts now, the one before it next.
    sent: tuple[jax.Array, ...]
    wait: jax.Array  # (...) time until that one arrives [s]


class Lines(NamedTuple):
    """The lines of steering and pedal; None where commands arrive at once."""

    steer: Line | None
    pedal: Line | None


def make_lines(sim: SimConfig, like: jax.Array) -> Lines:
    """Lines on which zeros travel, for cars of the shape of `like`."""
    zero = jnp.zeros_like(like)

    def line(delay: float) -> Line | None:
        count = _whole_steps(sim, delay) + 2
        return Line((zero,) * count, zero) if delay else None

    return Lines(line(sim.steering_delay), line(sim.pedal_delay))


def send(sim: SimConfig, lines: Lines, controls: jax.Array) -> Lines:
    """The lines at the start of a control step with its controls (..., 2)."""

    def sent(line: Line | None, command: jax.Array, delay: float) -> Line | None:
        if line is None:
            return None
        wait = delay - _whole_steps(sim, delay) * sim.ctrl_dt
        return Line((command, *line.sent[:-1]), jnp.full_like(line.wait, wait))

    return Lines(
        sent(lines.steer, controls[..., 0], sim.steering_delay),
        sent(lines.pedal, controls[..., 1], sim.pedal_delay),
    )


def receive(
    lines: Lines, controls: tuple[jax.Array, jax.Array], dt: float | jax.Array
) -> tuple[Lines, tuple[jax.Array, jax.Array]]:
    """The lines after a substep of `dt` [s], and steer and pedal that act during it."""
    after: list[Line | None] = []
    arrived: list[jax.Array] = []
    for line, control in zip(lines, controls, strict=True):
        if line is not None:
            early = line.wait > dt / 2
            control = jnp.where(early, line.sent[-1], line.sent[-2])
            line = dataclasses.replace(line, wait=line.wait - dt)
        after.append(line)
        arrived.append(control)
    return Lines(*after), (arrived[0], arrived[1])


def _whole_steps(sim: SimConfig, delay: float) -> int:
    """Control steps that end before a command of a step acts."""
    return math.ceil(delay / sim.ctrl_dt - 1e-6) - 1


@struct.dataclass
class Actuators:
    """State of steering and drive; any leading batch shape."""

    # (...) bicycle angle [rad], left positive, without `steering_offset`
    steering: jax.Array
    drive: jax.Array  # (...) drive torque, all driven wheels together [N m]
    # (...) how far the holding brake has closed, as the deceleration with which it
    # holds a standing car [m/s^2]; 0 is open
    hold: jax.Array
    lines: Lines | None = None  # commands under way; None where they arrive at once


class WheelTorques(NamedTuple):
    """Torques (...) [N m] of wheels."""

    drive: jax.Array  # forwards positive
    brake: jax.Array  # >= 0, opposes the wheel's rotation


def init_actuators(vehicle: Vehicle) -> Actuators:
    """Wheels straight, no drive, the holding brake closed; for cars (...) at rest."""
    zero = jnp.zeros_like(vehicle.mass)
    return Actuators(steering=zero, drive=zero, hold=vehicle.hold_deceleration)


def roll_freely(actuators: Actuators, speed: jax.Array) -> Actuators:
    """The actuators of cars (...) that begin at speeds [m/s]: no hold but at rest."""
    hold = jnp.where(speed == 0.0, actuators.hold, 0.0)
    return dataclasses.replace(actuators, hold=hold)


def approach(
    value: jax.Array, target: jax.Array, lag: jax.Array, dt: float | jax.Array
) -> jax.Array:
    """First-order lag over `dt` [s], exact for a constant target; lag 0 is no lag."""
    kept = jnp.exp(_quotient(jnp.asarray(-dt, lag.dtype), lag))
    return kept * value + (1.0 - kept) * target


def steer_towards(
    vehicle: Vehicle, steering: jax.Array, steer: jax.Array, dt: float | jax.Array
) -> jax.Array:
    """Moves the angle [rad] to `steer` in [-1, 1], with lag and at a limited rate."""
    target = jnp.clip(steer, -1.0, 1.0) * vehicle.max_steering
    target = approach(steering, target, vehicle.steering_lag, dt)
    limit = vehicle.steering_rate * dt
    return steering + jnp.clip(target - steering, -limit, limit)


def ackermann(vehicle: Vehicle, steering: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Angles [rad] of the left and right front wheels for bicycle angles (...) [rad].

    With `vehicle.ackermann` = 1 all wheels turn about one point on the rear axle:
    tan(left, right) = tan(steering) / (1 -+ track / (2 wheelbase) tan(steering)).
    """
    tan = jnp.tan(steering)
    skew = vehicle.ackermann * vehicle.track_width / (2 * vehicle.wheelbase) * tan
    return jnp.arctan(tan / (1.0 - skew)), jnp.arctan(tan / (1.0 + skew))


def close_hold(
    vehicle: Vehicle,
    hold: jax.Array,
    pedal: jax.Array,
    speed: jax.Array,
    dt: float | jax.Array,
) -> jax.Array:
    """The state of the holding brake (...), `Actuators.hold`, after `dt` [s].

    `speed` (...) is that of the rear axle, forwards [m/s].
    """
    strength = jnp.minimum(jnp.abs(pedal), 1.0)
    driven = strength >= HOLD_PEDAL
    released = driven & (jnp.sign(pedal) * speed >= OPEN_SPEED)
    idle = ~driven if vehicle.creep is None else ~driven & (hold > 0.0)
    wanted = idle | (pedal * speed < 0.0)
    closes = wanted & ((jnp.abs(speed) < HOLD_SPEED) | (hold > 0.0))
    closed = hold + (hold + HOLD_START) * (dt * (1.0 / HOLD_TIME))
    # It takes over the pedal's deceleration, for the moment the pedal is released.
    service = strength * vehicle.max_deceleration * (1.0 / HOLD_RAMP)
    closed = jnp.where(driven, jnp.maximum(closed, service), closed)
    closed = jnp.minimum(closed, vehicle.hold_deceleration)
    return jnp.where(released, 0.0, jnp.where(closes, closed, hold))


def hold_braking(vehicle: Vehicle, hold: jax.Array, speed: jax.Array) -> jax.Array:
    """Deceleration (...) of the holding brake [m/s^2], `hold` at rest."""
    rising = HOLD_RAMP * hold
    easing = hold + jnp.sqrt(2.0 * HOLD_EASE * jnp.abs(speed) + _TINY)
    return jnp.minimum(jnp.minimum(rising, easing), vehicle.hold_deceleration)


def demanded_torques(
    vehicle: Vehicle,
    pedal: jax.Array,
    hold: jax.Array,
    speed: jax.Array,
    wheel_speed: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Drive and brake torques (...) [N m] of all wheels that the pedal demands.

    The drive gives at most `max_drive_torque` and `max_power`. It fades out towards
    the speed limit, by the speed of the driven wheels where these spin, or it would
    diverge on ice. Beyond the limit the brakes slow the car down. See `actuate` for the
    arguments, and `Actuators.hold`.
    """
    pedal = jnp.clip(pedal, -1.0, 1.0)
    strength = jnp.abs(pedal)
    idle = strength < HOLD_PEDAL
    opposed = pedal * speed < 0.0
    braking = opposed & (jnp.abs(speed) >= SWITCH_SPEED)
    held = hold_braking(vehicle, hold, speed)
    # Below SWITCH_SPEED the brake fades as the drive takes over, without a jump of
    # both together. A closed hold stays: on a slope too steep for its drive, or too
    # slippery, the car creeps.
    fading = jnp.minimum(jnp.abs(speed) * (1.0 / SWITCH_SPEED), 1.0)
    service = fading * jnp.maximum(strength * vehicle.max_deceleration, held)
    by_drive = jnp.where(braking, 0.0, strength * vehicle.max_acceleration)
    service = jnp.maximum(service - by_drive, fading * hold)
    deceleration = jnp.where(idle, held, jnp.where(opposed, service, 0.0))
    over = jnp.maximum(speed - vehicle.max_speed, -speed - vehicle.max_reverse_speed)
    per_second = 1.0 / vehicle.speed_limit_time
    deceleration = deceleration + jnp.maximum(over, 0.0) * per_second

    spinning = jnp.abs(wheel_speed) > jnp.abs(speed) + SPINNING
    speed = jnp.where(spinning, wheel_speed, speed)
    headroom = jnp.maximum(vehicle.max_speed - speed, 0.0)
    reverse_headroom = jnp.maximum(speed + vehicle.max_reverse_speed, 0.0)
    wanted = pedal * vehicle.max_acceleration
    acceleration = jnp.clip(
        jnp.where(braking | (idle & (hold > 0.0)), 0.0, wanted),
        -reverse_headroom * per_second,
        headroom * per_second,
    )
    force_to_torque = vehicle.rated_mass * vehicle.wheel_radius
    by_power = _quotient(vehicle.max_power * vehicle.wheel_radius, jnp.abs(speed))
    most = jnp.minimum(vehicle.max_drive_torque, by_power)
    drive = jnp.clip(acceleration * force_to_torque, -most, most)
    return drive, deceleration * force_to_torque


def add_creep(
    vehicle: Vehicle,
    actuators: Actuators,
    drive: jax.Array,
    pedal: jax.Array,
    speed: jax.Array,
    wheel_speed: jax.Array,
) -> jax.Array:
    """Drive torque (...) [N m] of an automatic, at least that of its idling engine.

    It acts the way of the pedal, or that of the last drive, while no brake is pressed,
    and falls to none at `CREEP_SPEED`, as that of a converter does. The actuators have
    the hold after the substep and the drive before it.
    """
    if vehicle.creep is None:
        return drive
    driven = jnp.abs(pedal) >= HOLD_PEDAL
    last = jnp.where(actuators.drive == 0.0, speed, actuators.drive)
    way = jnp.sign(jnp.where(driven, pedal, last))
    free = (actuators.hold == 0.0) & ~(driven & (pedal * speed < 0.0))
    slip = jnp.clip(1.0 - way * wheel_speed * (1.0 / CREEP_SPEED), 0.0, 1.0)
    idling = vehicle.creep * slip * vehicle.rated_mass * vehicle.wheel_radius
    return jnp.where(free, way * jnp.maximum(way * drive, idling), drive)


def press_pedal(
    vehicle: Vehicle,
    actuators: Actuators,
    pedal: jax.Array,
    speed: jax.Array,
    wheel_speed: jax.Array,
    dt: float | jax.Array,
) -> tuple[Actuators, jax.Array]:
    """One substep: the actuators, and the brake torque (...) [N m]; see `actuate`."""
    hold = close_hold(vehicle, actuators.hold, pedal, speed, dt)
    drive, brake = demanded_torques(vehicle, pedal, hold, speed, wheel_speed)
    actuators = dataclasses.replace(actuators, hold=hold)
    drive = add_creep(vehicle, actuators, drive, pedal, speed, wheel_speed)
    drive = approach(actuators.drive, drive, vehicle.drive_lag, dt)
    return dataclasses.replace(actuators, drive=drive), brake


def actuate(
    vehicle: Vehicle,
    actuators: Actuators,
    controls: tuple[jax.Array, jax.Array],
    speed: jax.Array,
    wheel_speed: jax.Array,
    dt: float | jax.Array,
) -> tuple[Actuators, tuple[jax.Array, jax.Array], jax.Array]:
    """One substep from controls to wheels.

    Args:
        vehicle: cars (...).
        actuators: at the start of the substep.
        controls: steer and pedal (...) in [-1, 1], before their delay.
        speed: (...) of the rear axle, forwards positive [m/s].
        wheel_speed: (...) mean circumferential speed of the driven wheels [m/s].
        dt: substep [s].

    Returns:
        The actuators at its end; target angles (...) of the left and right front wheels
        [rad]; the brake torque (...) of all wheels together, which opposes their
        rotation, >= 0 [N m].
    """
    lines = actuators.lines
    if lines is not None:
        lines, controls = receive(lines, controls, dt)
    steer, pedal = controls
    steering = steer_towards(vehicle, actuators.steering, steer, dt)
    angles = ackermann(vehicle, steering + vehicle.steering_offset)
    actuators, brake = press_pedal(vehicle, actuators, pedal, speed, wheel_speed, dt)
    actuators = dataclasses.replace(actuators, steering=steering, lines=lines)
    return actuators, angles, brake


def stopping_action(speed: jax.Array) -> jax.Array:
    """The action (..., 2) that stops cars of speed (...) [m/s] and then holds them."""
    pedal = jnp.where(jnp.abs(speed) < HOLD_SPEED, 0.0, -jnp.sign(speed))
    return jnp.stack([jnp.zeros_like(pedal), pedal], axis=-1)
