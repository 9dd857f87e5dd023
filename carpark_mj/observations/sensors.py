"""What agents observe of the cars' motion: noisy, and late.

Judging, rewards and metrics use the true motion. A measurement is made once a control
step and shared by all who observe the car.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SensorConfig
from carpark_mj.types import Motion


@struct.dataclass
class Reading:
    """Measured motion of cars (...); frames and units of `Motion`.

    Attributes:
        pose_w: (..., 3).
        velocity_b: (..., 2).
        yaw_rate: (...).
        steering: (...).
    """

    pose_w: jax.Array
    velocity_b: jax.Array
    yaw_rate: jax.Array
    steering: jax.Array


@struct.dataclass
class Sensors:
    """Sensors of the agents of a lot.

    Attributes:
        history: readings (num_agents, delay_max + 1, ...), newest first.
        delay: (num_agents,) int32, control steps by which an agent's are late.
    """

    history: Reading
    delay: jax.Array


def init_sensors(
    config: SensorConfig, vehicle: Motion, key: jax.Array
) -> Sensors | None:
    """Sensors of cars (num_agents,) that spawn; None if they tell the truth.

    `key` is consumed.
    """
    if not config.is_on:
        return None
    reading_key, delay_key = jax.random.split(key)
    reading = _measure(config, vehicle, reading_key)
    history = jax.tree.map(
        lambda x: jnp.repeat(x[:, None], config.delay_max + 1, axis=1), reading
    )
    lowest, highest = config.delay_min, config.delay_max
    count = vehicle.yaw_rate.shape
    delay = jax.random.randint(delay_key, count, lowest, highest + 1, jnp.int32)
    return Sensors(history=history, delay=delay)


def update_sensors(
    config: SensorConfig,
    sensors: Sensors | None,
    vehicle: Motion,
    respawned: jax.Array,
    key: jax.Array,
) -> Sensors | None:
    """Adds the measurement of a control step.

    Args:
        config: errors.
        sensors: before the step.
        vehicle: (num_agents,) cars after it.
        respawned: (num_agents,) bool; those start with new sensors and no past.
        key: consumed.
    """
    if sensors is None:
        return None
    reading_key, fresh_key = jax.random.split(key)
    reading = _measure(config, vehicle, reading_key)
    history = jax.tree.map(
        lambda new, old: jnp.concatenate([new[:, None], old[:, :-1]], axis=1),
        reading,
        sensors.history,
    )
    return jax.tree.map(
        lambda new, old: jnp.where(
            respawned.reshape(-1, *([1] * (old.ndim - 1))), new, old
        ),
        init_sensors(config, vehicle, fresh_key),
        Sensors(history=history, delay=sensors.delay),
    )


def observed(sensors: Sensors | None, vehicle: Motion) -> Motion:
    """The motion (num_agents,) as the agents know it; the trace stays the true one."""
    if sensors is None:
        return vehicle
    agents = jnp.arange(sensors.delay.shape[0])
    late = jax.tree.map(lambda x: x[agents, sensors.delay], sensors.history)
    return dataclasses.replace(
        vehicle,
        pose_w=late.pose_w,
        velocity_b=late.velocity_b,
        yaw_rate=late.yaw_rate,
        steering=late.steering,
    )


def _measure(config: SensorConfig, vehicle: Motion, key: jax.Array) -> Reading:
    pose_key, speed_key = jax.random.split(key)
    pose_noise = jnp.array(
        [config.position_noise, config.position_noise, config.heading_noise],
        vehicle.pose_w.dtype,
    )
    shape, speed = vehicle.pose_w.shape, vehicle.velocity_b
    return Reading(
        pose_w=vehicle.pose_w + pose_noise * jax.random.normal(pose_key, shape),
        velocity_b=speed
        + config.speed_noise * jax.random.normal(speed_key, speed.shape),
        yaw_rate=vehicle.yaw_rate,
        steering=vehicle.steering,
    )
