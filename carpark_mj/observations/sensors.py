"""Sensors: the cars' motion as agents observe it, with drift, noise and delay.

Events, rewards and metrics use the true motion. A measurement is made once a control
step and is the same for all observers.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import SensorConfig
from carpark_mj.types import Motion, Reading, Sensors, State


def init_sensors(
    config: SensorConfig, motion: Motion, key: jax.Array
) -> Sensors | None:
    """Sensors of cars (num_agents,) that spawn; None if they measure exactly.

    `key` is consumed.
    """
    if not config.is_on:
        return None
    odometry = None
    if config.dead_reckons:
        from carpark_mj.observations.odometry import begin_odometry  # only they load it

        key, odometry_key = jax.random.split(key)
        odometry = begin_odometry(config, motion.pose_w, odometry_key)
    reading_key, delay_key = jax.random.split(key)
    reading = _read(config, motion, reading_key)
    history = jax.tree.map(
        lambda x: jnp.repeat(x[:, None], config.delay_max + 1, axis=1), reading
    )
    lowest, highest = config.delay_min, config.delay_max
    count = motion.yaw_rate.shape
    delay = jax.random.randint(delay_key, count, lowest, highest + 1, jnp.int32)
    return Sensors(history=history, delay=delay, odometry=odometry)


def measure(
    config: SensorConfig, before: State, motion: Motion, key: jax.Array
) -> Sensors | None:
    """The sensors with the measurement of a control step.

    Args:
        config: errors.
        before: the lot at the start of the step.
        motion: of the cars (num_agents,) at its end.
        key: consumed.
    """
    sensors = before.sensors
    if sensors is None:
        return None
    if sensors.odometry is not None:
        from carpark_mj.observations.odometry import reckon

        offset = before.physics.vehicle.centre_offset
        odometry = reckon(sensors.odometry, before.motion.pose_w, motion.pose_w, offset)
        sensors = dataclasses.replace(sensors, odometry=odometry)
        motion = dataclasses.replace(motion, pose_w=odometry.pose_w)
    history = jax.tree.map(
        lambda new, old: jnp.concatenate([new[:, None], old[:, :-1]], axis=1),
        _read(config, motion, key),
        sensors.history,
    )
    return dataclasses.replace(sensors, history=history)


def reset(
    config: SensorConfig,
    sensors: Sensors | None,
    motion: Motion,
    respawned: jax.Array,
    key: jax.Array,
) -> Sensors | None:
    """The sensors, reset without history for agents that have respawned.

    Args:
        config: errors.
        sensors: of all agents (num_agents,).
        motion: of the cars (num_agents,), respawned.
        respawned: (num_agents,) bool.
        key: consumed.
    """
    if sensors is None:
        return None
    return jax.tree.map(
        lambda new, old: jnp.where(
            respawned.reshape(-1, *([1] * (old.ndim - 1))), new, old
        ),
        init_sensors(config, motion, key),
        sensors,
    )


def observed(state: State) -> Motion:
    """The measured motion (num_agents,); the trace is the true one."""
    sensors = state.sensors
    if sensors is None:
        return state.motion
    agents = jnp.arange(sensors.delay.shape[0])
    late = jax.tree.map(lambda x: x[agents, sensors.delay], sensors.history)
    return dataclasses.replace(
        state.motion,
        pose_w=late.pose_w,
        velocity_b=late.velocity_b,
        yaw_rate=late.yaw_rate,
        steering=late.steering,
    )


def _read(config: SensorConfig, motion: Motion, key: jax.Array) -> Reading:
    pose_key, speed_key = jax.random.split(key)
    pose_noise = jnp.array(
        [config.position_noise, config.position_noise, config.heading_noise],
        motion.pose_w.dtype,
    )
    shape, speed = motion.pose_w.shape, motion.velocity_b
    return Reading(
        pose_w=motion.pose_w + pose_noise * jax.random.normal(pose_key, shape),
        velocity_b=speed
        + config.speed_noise * jax.random.normal(speed_key, speed.shape),
        yaw_rate=motion.yaw_rate,
        steering=motion.steering,
    )
