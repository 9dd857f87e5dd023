"""Rays: the free distance along bearings about the car, as a laser scanner sees it."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.config import RayConfig
from carpark_mj.geometry import rotate
from carpark_mj.geometry.broad_phase import is_crowded, visit_near
from carpark_mj.geometry.obstacles import Group, by_shape, merge, take
from carpark_mj.observations.fields import Field
from carpark_mj.observations.parts import Part, Sight
from carpark_mj.types import Motion

RAYS = "rays"  # names of the fields
RAYS_NEAR = "rays_near"
CHUNK = 8  # obstacles whose rays are computed at a time in a crowded lot


def rays_part(config: RayConfig) -> Part:
    """The field `rays`, and `rays_near` if the rays are to be seen in centimetres."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        free = cast_rays(config, sight.motion, sight.obstacles)
        if not config.near:
            return {RAYS: free}
        near = jnp.minimum(free * (config.reach / config.near), 1.0)
        return {RAYS: free, RAYS_NEAR: near}

    meaning = (
        f"free distance along bearings from ahead to the left [{config.reach:g} m]"
    )
    fields = (Field(RAYS, config.count, 0.0, 1.0, meaning),)
    if config.near:
        meaning = (
            f"free distance along the bearings of `rays` [{config.near:g} m], clipped"
        )
        fields += (Field(RAYS_NEAR, config.count, 0.0, 1.0, meaning),)
    return Part(fields, fill)


def cast_rays(
    config: RayConfig, motion: Motion, obstacles: Sequence[Group]
) -> jax.Array:
    """Free distance along the bearings (num_agents, count), divided by the reach.

    The rays start at the footprint's centre, the first one straight ahead, the others
    evenly spaced counter-clockwise in the body frame. The distance counts from the
    car's own outline to the nearest obstacle: 0 means touching at any bearing, 1 that
    no obstacle is within reach. It is exact for boxes and discs.

    Args:
        config: the rays.
        motion: the agents (num_agents,).
        obstacles: of the lot, agents included.
    """
    own_pose, own_size = motion.pose_w, motion.size
    count, reach = config.count, config.reach
    bearing = jnp.arange(count) * (2 * jnp.pi / count)
    ahead = jnp.stack([jnp.cos(bearing), jnp.sin(bearing)], axis=-1)
    direction = rotate(ahead, own_pose[:, None, 2])[:, None]  # (agents, 1, count, 2)
    # Once for a ray, not for each obstacle, which XLA would do to save memory.
    direction = jax.lax.optimization_barrier(direction)
    origin = own_pose[:, None, None, :2]
    outline = jnp.min(0.5 * own_size[:, None] / jnp.abs(ahead), axis=-1)
    free = outline + reach  # nothing farther away is seen
    for same in by_shape([group for group in obstacles if group.count]):
        them = merge(same, own_pose.shape[0])
        gap = jnp.where(them.counts, them.group.gaps(own_pose[:, :2]), jnp.inf)
        free = _shorten(free, gap, them.group, origin, direction)
    return jnp.clip((free - outline) / reach, 0.0, 1.0)


def _shorten(
    free: jax.Array,
    gap: jax.Array,
    group: Group,
    origin: jax.Array,
    direction: jax.Array,
) -> jax.Array:
    """Free distances (num_agents, count) cut where they meet any of n obstacles.

    Args:
        free: so far [m].
        gap: (num_agents, n) from the agents' centres to the obstacles; inf = no such.
        group: the obstacles.
        origin: (num_agents, 1, 1, 2) where the rays begin [m].
        direction: (num_agents, 1, count, 2) unit vectors.
    """
    if not is_crowded(*gap.shape):
        found = take(group, None).ray_distance(origin, direction)
        found = jnp.where(jnp.isinf(gap)[..., None], jnp.inf, found)
        return jnp.minimum(free, jnp.min(found, axis=1, initial=jnp.inf))

    def visit(free: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        found = take(group, index).ray_distance(origin, direction)
        found = jnp.where(valid[..., None], found, jnp.inf)
        return jnp.minimum(free, jnp.min(found, axis=1))

    # An obstacle that begins beyond an agent's longest ray can shorten none of them.
    return visit_near(gap, lambda free: jnp.max(free, axis=1), visit, free, CHUNK)
