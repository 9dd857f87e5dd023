"""From an action to steering angles and wheel torques.

An action is `[steer, pedal]` in [-1, 1]^2. `steer` asks for a road-wheel angle of the
bicycle model, reached at a limited rate and shared between the front wheels by the
Ackermann condition. `pedal` asks for an acceleration: along the motion it drives,
against it it brakes, but for pedals below `HOLD_PEDAL`; a car slower than
`SWITCH_SPEED` it drives either way. Where the car or its wheels are slower than
`HOLD_SPEED`, braking or no pedal means the holding brake: wheels that stand stay
locked, even where the car slides. So from `SWITCH_SPEED` up no pedal against the motion
slows a car down less than a weaker one. Steering and drive may follow with a
first-order lag. All functions are elementwise, for cars of any shape.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry.gradients import finite_slope
from carpark_mj.vehicle.vehicle import Vehicle

SWITCH_SPEED = 0.1  # m/s, below it a pedal against the motion drives the new way
HOLD_PEDAL = 0.05  # pedals smaller than this mean "no pedal"
HOLD_SPEED = 0.3  # m/s, of car or wheels; below it the brake holds what is not driven
SPINNING = 0.5  # m/s of the driven wheels above the car's speed: they spin

_quotient = finite_slope(jnp.divide)  # by a speed or lag of 0 it is infinite


@struct.dataclass
class Actuators:
    """State of steering and drive; any leading batch shape.

    Attributes:
        steering: (...) bicycle angle [rad], left positive, without `steering_offset`.
        drive: (...) drive torque, all driven wheels together [N m].
    """

    steering: jax.Array
    drive: jax.Array


class WheelTorques(NamedTuple):
    """Torques (...) [N m] of wheels.

    Attributes:
        drive: forwards positive.
        brake: >= 0, opposes the wheel's rotation.
    """

    drive: jax.Array
    brake: jax.Array


def init_actuators(dtype: jnp.dtype | None = None) -> Actuators:
    """Wheels straight, no drive; one car."""
    zero = jnp.zeros((), dtype)
    return Actuators(steering=zero, drive=zero)


def approach(
    value: jax.Array, target: jax.Array, lag: jax.Array, dt: float | jax.Array
) -> jax.Array:
    """First-order lag over `dt` [s], exact for a constant target; lag 0 is no lag."""
    kept = jnp.exp(_quotient(jnp.asarray(-dt, lag.dtype), lag))
    return kept * value + (1.0 - kept) * target


def steer_towards(
    vehicle: Vehicle, steering: jax.Array, steer: jax.Array, dt: float | jax.Array
) -> jax.Array:
    """Moves the steering angle [rad] towards `steer` in [-1, 1].

    First-order with `steering_lag`, and never faster than `steering_rate`.
    """
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


def demanded_torques(
    vehicle: Vehicle, pedal: jax.Array, speed: jax.Array, wheel_speed: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Drive and brake torques that the pedal asks for.

    The drive gives at most `max_drive_torque` and `max_power`. The speed limiter goes
    by the driven wheels once they spin, or their speed would diverge on ice.

    Args:
        vehicle: one car.
        pedal: () in [-1, 1].
        speed: () forward speed of the rear axle [m/s].
        wheel_speed: () mean circumferential speed of the driven wheels [m/s].

    Returns:
        Drive torque () [N m] of all driven wheels, positive forwards, and brake torque
        () [N m] of all wheels, >= 0, which opposes their rotation.
    """
    pedal = jnp.clip(pedal, -1.0, 1.0)
    idle = jnp.abs(pedal) < HOLD_PEDAL
    opposed = pedal * speed < 0.0
    braking = opposed & (jnp.abs(speed) >= SWITCH_SPEED)
    slow = jnp.minimum(jnp.abs(speed), jnp.abs(wheel_speed)) < HOLD_SPEED
    deceleration = jnp.where(
        opposed & ~idle, jnp.abs(pedal) * vehicle.max_deceleration, 0.0
    )
    deceleration = jnp.where(
        slow & (opposed | idle),
        jnp.maximum(deceleration, vehicle.hold_deceleration),
        deceleration,
    )
    # Below SWITCH_SPEED the brake fades as the drive takes over: with a jump the car
    # would chatter at that speed, on a slope against its drive.
    fading = jnp.minimum(jnp.abs(speed) / SWITCH_SPEED, 1.0)
    deceleration = jnp.where(idle, deceleration, fading * deceleration)
    spinning = jnp.abs(wheel_speed) > jnp.abs(speed) + SPINNING
    speed = jnp.where(spinning, wheel_speed, speed)
    # The speed limiter caps the acceleration so that the car closes on its limit
    # exponentially; beyond the limit it slows the car down (engine braking), without
    # a pedal and beside the brake, but does not turn wheels that are held.
    headroom = (vehicle.max_speed - speed) / vehicle.speed_limit_time
    reverse_headroom = (-vehicle.max_reverse_speed - speed) / vehicle.speed_limit_time
    wanted = jnp.where(braking, 0.0, pedal * vehicle.max_acceleration)
    acceleration = jnp.clip(wanted, reverse_headroom, headroom)
    acceleration = jnp.where(slow & (braking | idle), 0.0, acceleration)
    force_to_torque = vehicle.rated_mass * vehicle.wheel_radius
    by_power = _quotient(vehicle.max_power * vehicle.wheel_radius, jnp.abs(speed))
    most = jnp.minimum(vehicle.max_drive_torque, by_power)
    drive = jnp.clip(acceleration * force_to_torque, -most, most)
    return drive, deceleration * force_to_torque


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
        controls: steer and pedal (...) in [-1, 1].
        speed: (...) forward speed of the rear axle [m/s].
        wheel_speed: (...) mean circumferential speed of the driven wheels [m/s].
        dt: substep [s].

    Returns:
        The actuators at its end, with the drive torque of all wheels together; target
        angles (...) of the left and right front wheels [rad]; the brake torque (...)
        of all wheels together [N m].
    """
    steer, pedal = controls
    steering = steer_towards(vehicle, actuators.steering, steer, dt)
    angles = ackermann(vehicle, steering + vehicle.steering_offset)
    drive, brake = demanded_torques(vehicle, pedal, speed, wheel_speed)
    drive = approach(actuators.drive, drive, vehicle.drive_lag, dt)
    return Actuators(steering=steering, drive=drive), angles, brake


def stopping_action(speed: jax.Array) -> jax.Array:
    """The action (..., 2) that stops cars of speed (...) [m/s] and then holds them."""
    pedal = jnp.where(jnp.abs(speed) < HOLD_SPEED, 0.0, -jnp.sign(speed))
    return jnp.stack([jnp.zeros_like(pedal), pedal], axis=-1)
