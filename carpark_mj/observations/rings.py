"""Proximity rings: how many walls a circle about the car touches."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import point_box_distance


def wall_rings(
    own_xy: jax.Array,
    wall_pose: jax.Array,
    wall_size: jax.Array,
    wall_mask: jax.Array,
    diameters: tuple[float, ...],
    cap: int,
) -> jax.Array:
    """Capped wall counts (num_agents, rings), divided by the cap.

    Args:
        own_xy: (num_agents, 2) centres of the circles [m].
        wall_pose: (walls, 3).
        wall_size: (walls, 2) [m].
        wall_mask: (walls,) bool.
        diameters: of the rings [m].
        cap: largest count reported.
    """
    gap = point_box_distance(own_xy[:, None], wall_pose, wall_size)
    gap = jnp.where(wall_mask, gap, jnp.inf)
    radii = jnp.array(diameters, gap.dtype) / 2
    count = jnp.sum(gap[:, :, None] < radii, axis=1)
    return jnp.minimum(count, cap) / cap
