"""From an action to steering angles and wheel torques.

An action is `[steer, pedal]` in [-1, 1]^2. `steer` asks for a road-wheel angle of the
bicycle model, reached at a limited rate and shared between the front wheels by the
Ackermann condition. `pedal` asks for an acceleration: against the motion it brakes,
below `SWITCH_SPEED` it drives the new way, and close to zero at walking pace it holds
the car on the brake. All functions are for one car; `jax.vmap` them for more.
"""

import jax
import jax.numpy as jnp

from carpark_mj.vehicle.vehicle import Vehicle

SWITCH_SPEED = 0.1  # m/s, below it a pedal against the motion drives the new way
HOLD_PEDAL = 0.05  # pedals smaller than this mean "no pedal"
HOLD_SPEED = 0.3  # m/s, below it "no pedal" holds the car on the brake


def steer_towards(
    vehicle: Vehicle, steering: jax.Array, steer: jax.Array, dt: float
) -> jax.Array:
    """Moves the steering angle [rad] towards `steer` in [-1, 1] at the limited rate."""
    target = jnp.clip(steer, -1.0, 1.0) * vehicle.max_steering
    limit = vehicle.steering_rate * dt
    return steering + jnp.clip(target - steering, -limit, limit)


def ackermann(vehicle: Vehicle, steering: jax.Array) -> jax.Array:
    """Angles (2,) [rad] of the left and right front wheels for a bicycle angle [rad].

    With `vehicle.ackermann` = 1 all wheels turn about one point on the rear axle:
    tan(left, right) = tan(steering) / (1 -+ track / (2 wheelbase) tan(steering)).
    """
    tan = jnp.tan(steering)
    skew = vehicle.ackermann * vehicle.track_width / (2 * vehicle.wheelbase) * tan
    return jnp.arctan(jnp.stack([tan / (1.0 - skew), tan / (1.0 + skew)]))


def wheel_torques(
    vehicle: Vehicle, pedal: jax.Array, speed: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Drive and brake torques at the wheels.

    Args:
        vehicle: one car.
        pedal: () in [-1, 1].
        speed: () forward speed of the rear axle [m/s].

    Returns:
        Drive torque (4,) [N m], positive forwards, and brake torque (4,) [N m], >= 0,
        which opposes whatever way the wheel turns.
    """
    pedal = jnp.clip(pedal, -1.0, 1.0)
    braking = (pedal * speed < 0.0) & (jnp.abs(speed) >= SWITCH_SPEED)
    holding = (jnp.abs(pedal) < HOLD_PEDAL) & (jnp.abs(speed) < HOLD_SPEED)
    # The speed limiter caps the acceleration so that the car closes on its limit
    # exponentially; beyond the limit it slows the car down (engine braking).
    headroom = (vehicle.max_speed - speed) / vehicle.speed_limit_time
    reverse_headroom = (-vehicle.max_reverse_speed - speed) / vehicle.speed_limit_time
    acceleration = jnp.clip(
        pedal * vehicle.max_acceleration, reverse_headroom, headroom
    )
    acceleration = jnp.where(braking | holding, 0.0, acceleration)
    deceleration = jnp.where(braking, jnp.abs(pedal) * vehicle.max_deceleration, 0.0)
    deceleration = jnp.where(holding, vehicle.hold_deceleration, deceleration)
    force_to_torque = vehicle.mass * vehicle.wheel_radius
    drive = acceleration * force_to_torque * vehicle.drive_share
    brake = deceleration * force_to_torque * vehicle.brake_share
    return drive, brake


def stopping_action(speed: jax.Array) -> jax.Array:
    """The action (..., 2) that stops cars of speed (...) [m/s] and then holds them."""
    pedal = jnp.where(jnp.abs(speed) < HOLD_SPEED, 0.0, -jnp.sign(speed))
    return jnp.stack([jnp.zeros_like(pedal), pedal], axis=-1)
