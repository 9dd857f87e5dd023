"""Rays: the free way along bearings about the car, as a laser scanner sees it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from carpark_mj.config import RayConfig
from carpark_mj.geometry import ray_box_distance, ray_disc_distance, rotate
from carpark_mj.geometry.broad_phase import box_gaps, disc_gaps, is_crowded, visit_near
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import Field
from carpark_mj.observations.parts import Part, Sight
from carpark_mj.types import Motion, ParkedCars

RAYS = "rays"  # name of the field
CHUNK = 8  # obstacles whose rays are computed at a time in a crowded lot


def rays_part(config: RayConfig) -> Part:
    """The field `rays`."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        parked_cars = sight.state.parked_cars
        return {RAYS: cast_rays(config, sight.layout, sight.motion, parked_cars)}

    meaning = f"free way along bearings from ahead to the left [{config.reach:g} m]"
    return Part((Field(RAYS, config.count, 0.0, 1.0, meaning),), fill)


def cast_rays(
    config: RayConfig, layout: Layout, motion: Motion, parked_cars: ParkedCars
) -> jax.Array:
    """Free way along the bearings (num_agents, count), divided by the reach.

    The rays start at the footprint's centre, the first one straight ahead, the others
    evenly spaced counter-clockwise in the body frame. The way is measured from where a
    ray leaves the car's own outline, so that 0 means touching whatever the bearing,
    to the nearest wall, disc, parked car or other agent; 1 means that nothing is hit
    within reach. Exact, on boxes and discs alike.

    Args:
        config: the rays.
        layout: the lot, for its walls and discs.
        motion: the agents (num_agents,).
        parked_cars: (num_parked_cars,).
    """
    own_pose, own_size = motion.pose_w, motion.size
    num_agents, count, reach = own_pose.shape[0], config.count, config.reach
    bearing = jnp.arange(count) * (2 * jnp.pi / count)
    ahead = jnp.stack([jnp.cos(bearing), jnp.sin(bearing)], axis=-1)
    direction = rotate(ahead, own_pose[:, None, 2])[:, None]  # (agents, 1, count, 2)
    origin = own_pose[:, None, None, :2]
    outline = jnp.min(0.5 * own_size[:, None] / jnp.abs(ahead), axis=-1)

    def box_way(pose: jax.Array, size: jax.Array) -> jax.Array:
        return ray_box_distance(origin, direction, pose[..., None, :], size[:, :, None])

    def disc_way(centre: jax.Array, radius: jax.Array) -> jax.Array:
        return ray_disc_distance(
            origin, direction, centre[..., None, :], radius[..., None]
        )

    pose = jnp.concatenate([own_pose, parked_cars.pose_w, layout.wall_pose])
    size = jnp.concatenate([own_size, parked_cars.size, layout.wall_size])
    still = jnp.concatenate([parked_cars.present, layout.wall_mask])
    still = jnp.broadcast_to(still, (num_agents, still.shape[0]))
    others = ~jnp.eye(num_agents, dtype=bool)
    counts = jnp.concatenate([others, still], axis=1)
    gap = box_gaps(own_pose[:, :2], pose, size)
    way = outline + reach  # nothing farther away is seen
    way = _shorten(way, jnp.where(counts, gap, jnp.inf), box_way, pose, size)
    if layout.disc_mask.shape[0]:
        centre, radius = layout.disc_centre, layout.disc_radius
        gap = disc_gaps(own_pose[:, :2], centre, radius)
        gap = jnp.where(layout.disc_mask, gap, jnp.inf)
        way = _shorten(way, gap, disc_way, centre, radius)
    return jnp.clip((way - outline) / reach, 0.0, 1.0)


def _shorten(
    way: jax.Array,
    gap: jax.Array,
    find: Callable[[jax.Array, jax.Array], jax.Array],
    where: jax.Array,
    size: jax.Array,
) -> jax.Array:
    """Ways (num_agents, count) cut where they meet any of n obstacles.

    Args:
        way: so far [m].
        gap: (num_agents, n) from the agents' centres to the obstacles; inf = no such.
        find: ways (num_agents, k, count) to obstacles (num_agents or 1, k, ...).
        where: (n, ...) poses or centres.
        size: (n, ...) sizes or radii.
    """
    if not is_crowded(*gap.shape):
        found = jnp.where(
            jnp.isinf(gap)[..., None], jnp.inf, find(where[None], size[None])
        )
        return jnp.minimum(way, jnp.min(found, axis=1, initial=jnp.inf))

    def visit(way: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        found = jnp.where(valid[..., None], find(where[index], size[index]), jnp.inf)
        return jnp.minimum(way, jnp.min(found, axis=1))

    # An obstacle that begins beyond an agent's longest ray can shorten none of them.
    return visit_near(gap, lambda way: jnp.max(way, axis=1), visit, way, CHUNK)
