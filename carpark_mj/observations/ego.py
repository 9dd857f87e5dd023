"""What an agent knows of itself and its goal."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import to_local
from carpark_mj.observations.fields import FAR, NEAR
from carpark_mj.types import Motion


def own_motion(
    vehicle: Motion, max_speed: jax.Array, max_steering: jax.Array
) -> dict[str, jax.Array]:
    """Own speed, steering and yaw rate of every agent (num_agents, 1)."""
    return {
        "speed": (vehicle.speed / max_speed)[..., None],
        "steering": (vehicle.steering / max_steering)[..., None],
        "yaw_rate": vehicle.yaw_rate[..., None],
    }


def own_goal(
    vehicle: Motion, goal_pose: jax.Array, goal_size: jax.Array
) -> dict[str, jax.Array]:
    """The goal seen by every agent; `goal_pose` (num_agents, 3)."""
    local = to_local(vehicle.pose_w, goal_pose)
    inverse = to_local(goal_pose, vehicle.pose_w)
    xy = local[..., :2]
    return {
        "goal_position": xy / FAR,
        "goal_near": jnp.clip(xy / NEAR, -1.0, 1.0),
        "goal_heading": jnp.stack(
            [jnp.cos(local[..., 2]), jnp.sin(local[..., 2])], axis=-1
        ),
        "goal_distance": jnp.linalg.norm(xy, axis=-1, keepdims=True) / FAR,
        "in_bay": jnp.clip(inverse[..., :2] / NEAR, -1.0, 1.0),
        "goal_size": (goal_size - vehicle.size) / 5.0,
    }


def own_car(
    vehicle: Motion,
    wheelbase: jax.Array,
    rear_axle: jax.Array,
    max_steering: jax.Array,
) -> dict[str, jax.Array]:
    """What every agent drives; the other arguments (num_agents,) [m], [rad]."""
    radius = wheelbase / jnp.tan(max_steering)
    return {
        "own_size": vehicle.size / 5.0,
        "own_wheelbase": wheelbase[..., None] / 5.0,
        "own_rear_axle": rear_axle[..., None] / 5.0,
        "own_turning_radius": radius[..., None] / 5.0,
    }
