"""Dead reckoning by wheel odometry: the pose that a car believes in drifts.

The errors are the systematic ones of Borenstein and Feng ("Measurement and correction
of systematic odometry errors in mobile robots", 1996): wheels of another size than
assumed, of different sizes left and right, and another track width. They last an
episode, at whose start the pose is known.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import SensorConfig
from carpark_mj.geometry import move_forward, wrap_angle
from carpark_mj.types import Odometry


def begin_odometry(config: SensorConfig, pose_w: jax.Array, key: jax.Array) -> Odometry:
    """Odometry of cars that start at poses (num_agents, 3); `key` is consumed."""
    spread = jnp.array(
        [config.odometry_scale, config.odometry_veer, config.odometry_turn],
        pose_w.dtype,
    )
    return Odometry(pose_w, spread * jax.random.normal(key, pose_w.shape))


def reckon(
    odometry: Odometry, before_w: jax.Array, after_w: jax.Array, offset: jax.Array
) -> Odometry:
    """The odometry after a way.

    The rear axle's wheels measure how far it rolled and how much it turned, not how it
    slipped to the side.

    Args:
        odometry: of cars (...), at the start.
        before_w: (..., 3) true poses of the footprints' centres at the start.
        after_w: (..., 3) true poses at the end, less than half a turn away.
        offset: (...) from the rear axles to the centres [m].
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
