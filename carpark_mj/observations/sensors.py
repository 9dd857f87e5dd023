"""Sensors: the cars' motion as agents observe it, with drift, noise and delay.

Events, rewards and metrics use the true motion. A measurement is made once a control
step and equal for all observers.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import CheckedConfig, Natural, NonNegative, data, is_off
from carpark_mj.geometry import move_forward, rotate, wrap_angle
from carpark_mj.types import Motion, Odometry, Reading, Sensors, State


@dataclasses.dataclass(frozen=True)
class SensorConfig(CheckedConfig):
    """Errors of the observed motion of cars; none by default.

    Attributes:
        position_noise: standard deviation of the white noise on x and y [m].
        heading_noise: standard deviation of the white noise on the yaw [rad].
        speed_noise: standard deviation of white noise on speeds forward and left [m/s].
        delay_min: shortest delay of a car's measurements [control steps].
        delay_max: longest delay [control steps]; the delay is drawn at every spawn.
        odometry_scale: standard deviation, over episodes, of the relative error of the
            distance that the wheels measure [m/m]. Where this or one of the next two
            is not 0, a car knows its pose by dead reckoning from its start.
        odometry_veer: standard deviation of the heading's error per distance [rad/m].
        odometry_turn: standard deviation of the heading's error per turn [rad/rad].
    """

    position_noise: NonNegative = data(0.0, off=0.0)
    heading_noise: NonNegative = data(0.0, off=0.0)
    speed_noise: NonNegative = data(0.0, off=0.0)
    delay_min: Natural = 0
    delay_max: Natural = 0
    odometry_scale: NonNegative = data(0.0, off=0.0)
    odometry_veer: NonNegative = data(0.0, off=0.0)
    odometry_turn: NonNegative = data(0.0, off=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay_max < self.delay_min:
            raise ValueError(
                f"delay_max must be at least delay_min {self.delay_min}, not "
                f"{self.delay_max}"
            )

    @functools.cached_property
    def is_on(self) -> bool:
        """Whether observations differ from the true motion."""
        return not all(map(is_off, vars(self).values()))


def init_sensors(
    config: SensorConfig, motion: Motion, key: jax.Array
) -> Sensors | None:
    """Sensors of cars (num_agents,) that spawn, None if exact; `key` is consumed."""
    if not config.is_on:
        return None
    odometry = None
    drift = config.odometry_scale, config.odometry_veer, config.odometry_turn
    if not all(map(is_off, drift)):
        key, odometry_key = jax.random.split(key)
        odometry = begin_odometry(config, motion.pose_w, odometry_key)
    reading_key, delay_key = jax.random.split(key)
    reading = _read(config, motion, reading_key)
    low, ends, count = config.delay_min, config.delay_max + 1, motion.yaw_rate.shape
    history = jax.tree.map(lambda x: jnp.repeat(x[:, None], ends, axis=1), reading)
    delay = jax.random.randint(delay_key, count, low, ends, jnp.int32)
    return Sensors(history=history, delay=delay, odometry=odometry)


def measure(
    config: SensorConfig, before: State, motion: Motion, key: jax.Array
) -> Sensors | None:
    """The sensors with the measurement of a control step; `key` is consumed.

    The lot is that before the step, `motion` of the cars (num_agents,) that after it.
    """
    sensors = before.sensors
    if sensors is None:
        return None
    if sensors.odometry is not None:
        offset = before.physics.vehicle.centre_offset
        odometry = reckon(sensors.odometry, before.motion.pose_w, motion.pose_w, offset)
        sensors = dataclasses.replace(sensors, odometry=odometry)
        motion = dataclasses.replace(motion, pose_w=odometry.pose_w)

    def shift(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.concatenate([new[:, None], old[:, :-1]], axis=1)

    history = jax.tree.map(shift, _read(config, motion, key), sensors.history)
    return dataclasses.replace(sensors, history=history)


def reset(
    config: SensorConfig,
    sensors: Sensors | None,
    motion: Motion,
    respawned: jax.Array,
    key: jax.Array,
) -> Sensors | None:
    """The sensors, without history for agents that respawned; `key` is consumed."""
    if sensors is None:
        return None

    def choose(new: jax.Array, old: jax.Array) -> jax.Array:
        return jnp.where(respawned.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    return jax.tree.map(choose, init_sensors(config, motion, key), sensors)


def observed(state: State) -> Motion:
    """The measured motion (num_agents,); the trace is the true one."""
    sensors = state.sensors
    if sensors is None:
        return state.motion
    agents = jnp.arange(sensors.delay.shape[0])
    late = jax.tree.map(lambda x: x[agents, sensors.delay], sensors.history)
    return dataclasses.replace(state.motion, **vars(late))


def predicted(state: State, dt: float) -> Motion:
    """The measured motion (num_agents,), brought from late readings to the present.

    Only poses are late: a car knows its speed and yaw rate at once, and moves its last
    known pose on by those of its rear axle since, read every `dt` [s].
    """
    motion, sensors = observed(state), state.sensors
    if sensors is None:
        return motion
    past, offset = sensors.history, state.physics.vehicle.centre_offset
    late = jnp.minimum(sensors.delay, state.step)[:, None]  # none before the episode
    way, turn = (
        dt * (x[:, 1:] + x[:, :-1]) / 2 for x in (past.velocity_b, past.yaw_rate)
    )
    pose = move_forward(motion.pose_w, -offset)
    for age in reversed(range(turn.shape[1])):
        xy = rotate(way[:, age], pose[:, 2] + turn[:, age] / 2)
        moved = pose + jnp.concatenate([xy, turn[:, age, None]], axis=-1)
        pose = jnp.where(age < late, moved, pose)
    pose = move_forward(pose.at[:, 2].set(wrap_angle(pose[:, 2])), offset)
    newest = jax.tree.map(lambda x: x[:, 0], past)
    return dataclasses.replace(motion, **vars(newest) | {"pose_w": pose})


def _read(config: SensorConfig, motion: Motion, key: jax.Array) -> Reading:
    pose_key, speed_key = jax.random.split(key)
    pose, speed, xy = motion.pose_w, motion.velocity_b, config.position_noise
    noise = jnp.array([xy, xy, config.heading_noise], pose.dtype)
    pose = pose + noise * jax.random.normal(pose_key, pose.shape)
    speed = speed + config.speed_noise * jax.random.normal(speed_key, speed.shape)
    return Reading(pose, speed, motion.yaw_rate, motion.steering)


def begin_odometry(config: SensorConfig, pose_w: jax.Array, key: jax.Array) -> Odometry:
    """Odometry of cars that start at poses (num_agents, 3); `key` is consumed.

    The errors are the systematic ones of Borenstein and Feng ("Measurement and
    correction of systematic odometry errors in mobile robots", 1996): wheels of another
    size than assumed, of different sizes left and right, and another track width. They
    last an episode, at whose start the pose is known.
    """
    spread = [config.odometry_scale, config.odometry_veer, config.odometry_turn]
    error = jnp.array(spread, pose_w.dtype) * jax.random.normal(key, pose_w.shape)
    return Odometry(pose_w, error)


def reckon(
    odometry: Odometry, before_w: jax.Array, after_w: jax.Array, offset: jax.Array
) -> Odometry:
    """The odometry of cars (...) that have moved between two true poses (..., 3).

    The rear axle's wheels measure how far it rolled and how much it turned, less than
    half a turn, not how it slipped to the side. `offset` (...) is from the rear axles
    to the footprints' centres, whose poses these are [m].
    """
    way = move_forward(after_w, -offset) - move_forward(before_w, -offset)
    turned = wrap_angle(way[..., 2])
    course = before_w[..., 2] + turned / 2
    rolled = way[..., 0] * jnp.cos(course) + way[..., 1] * jnp.sin(course)
    scale, veer, turn = (odometry.error[..., i] for i in range(3))
    believed = (1.0 + turn) * turned + veer * rolled
    rear = move_forward(odometry.pose_w, -offset)
    yaw = rear[..., 2] + believed / 2
    rear = move_forward(rear.at[..., 2].set(yaw), (1.0 + scale) * rolled)
    rear = rear.at[..., 2].set(wrap_angle(yaw + believed / 2))
    return Odometry(move_forward(rear, offset), odometry.error)
