"""Where an agent starts: at random in the spawn regions, or close to its goal."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.geometry import rotate, wrap_angle
from carpark_mj.layouts.types import Layout


def spawn_pose(
    config: SpawnConfig,
    layout: Layout,
    goal_pose: jax.Array,
    other_xy: jax.Array,
    other_mask: jax.Array,
    key: jax.Array,
    blocked: Callable[[jax.Array], jax.Array] | None = None,
) -> jax.Array:
    """Draws a start pose for one agent.

    Headings are uniform within the spread of the spawn region. A random spawn is
    uniform over the spawn regions; a close one lies on a walk of up to
    `close_distance` from the region's point nearest to the goal, or is random if other
    agents leave no room there. The first of `num_candidates` draws that keeps
    `min_distance` to every other agent is taken, else the draw farthest from them.

    Args:
        config: spawning rules.
        layout: the lot.
        goal_pose: (3,) pose of the agent's goal.
        other_xy: (num_agents, 2) centres of the agents [m].
        other_mask: (num_agents,) bool, the agents to keep away from.
        key: consumed.
        blocked: says of poses (n, 3) whether the car would touch something there; such
            draws are taken only if there is no other. None = nowhere, as is true of
            cars no larger than the one the lot was drawn for.

    Returns:
        (3,) pose of the footprint's centre.
    """
    n = config.num_candidates
    region_key, point_key, walk_key, yaw_key, close_key = jax.random.split(key, 5)
    area = jnp.where(layout.spawn_mask, jnp.prod(layout.spawn_size, axis=-1), 0.0)
    region = jax.random.categorical(region_key, jnp.log(area), shape=(n,))
    pose, size = layout.spawn_pose[region], layout.spawn_size[region]
    # local = U(-size / 2, size / 2) in the region's frame.
    local = (jax.random.uniform(point_key, (n, 2)) - 0.5) * (size + config.grid)
    if config.grid:  # half a spacing more on each side: points on the edge count fully
        edge = jnp.floor(0.5 * size / config.grid + 1e-4)
        local = jnp.clip(jnp.round(local / config.grid), -edge, edge) * config.grid
    random_xy = pose[:, :2] + rotate(local, pose[:, 2])

    close_xy, nearest = _close_points(config, layout, goal_pose[:2], n, walk_key)
    stray = jax.random.uniform(yaw_key, (n,), minval=-1.0, maxval=1.0)

    def room(xy: jax.Array) -> jax.Array:
        gap = jnp.linalg.norm(xy[:, None] - other_xy, axis=-1)
        return jnp.where(other_mask, gap, jnp.inf).min(axis=-1)

    # Close to the goal only if somebody else is not: Tanner falls back likewise.
    close = jax.random.uniform(close_key) < config.close_ratio
    close = close & (room(close_xy) > config.min_distance).any()
    xy = jnp.where(close, close_xy, random_xy)
    region = jnp.where(close, nearest, region)
    heading = layout.spawn_pose[region, 2] + layout.spawn_spread[region] * stray
    yaw = wrap_angle(heading)
    gap = room(xy)
    if blocked is not None:
        pose = jnp.concatenate([xy, yaw[:, None]], axis=-1)
        gap = jnp.where(blocked(pose), -1.0, gap)
    keeps = gap > config.min_distance
    best = jnp.where(keeps.any(), jnp.argmax(keeps), jnp.argmax(gap))
    return jnp.concatenate([xy[best], yaw[best][None]])


def _close_points(
    config: SpawnConfig, layout: Layout, goal_xy: jax.Array, n: int, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Points (n, 2) near the goal within the spawn region closest to it, and which."""
    angle_key, reach_key = jax.random.split(key)
    local = rotate(goal_xy - layout.spawn_pose[:, :2], -layout.spawn_pose[:, 2])
    half = layout.spawn_size / 2
    nearest = jnp.clip(local, -half, half)
    gap = jnp.linalg.norm(local - nearest, axis=-1)
    region = jnp.argmin(jnp.where(layout.spawn_mask, gap, jnp.inf))
    angle = jax.random.uniform(angle_key, (n,), maxval=2 * jnp.pi)
    reach = jax.random.uniform(reach_key, (n,), maxval=config.close_distance)
    step = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1) * reach[:, None]
    # Tanner walks on a grid; here it is one straight step, clipped to the region.
    point = jnp.clip(nearest[region] + step, -half[region], half[region])
    pose = layout.spawn_pose[region]
    return pose[:2] + rotate(point, pose[2]), region
