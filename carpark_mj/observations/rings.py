"""Proximity rings: how many walls and discs a circle about the car touches."""

import jax
import jax.numpy as jnp

from carpark_mj.broad_phase import disc_gaps
from carpark_mj.geometry import point_box_distance
from carpark_mj.layouts.types import Layout


def count_rings(
    own_xy: jax.Array, layout: Layout, diameters: tuple[float, ...], cap: int
) -> jax.Array:
    """Capped counts (num_agents, rings) of walls and discs, divided by the cap.

    Every wall is looked at: nothing cheaper than this distance could rule it out.

    Args:
        own_xy: (num_agents, 2) centres of the circles [m].
        layout: the lot.
        diameters: of the rings [m].
        cap: largest count reported.
    """
    gap = point_box_distance(own_xy[:, None], layout.wall_pose, layout.wall_size)
    gap = jnp.where(layout.wall_mask, gap, jnp.inf)
    if layout.disc_mask.shape[0]:
        discs = disc_gaps(own_xy, layout.disc_centre, layout.disc_radius)
        discs = jnp.where(layout.disc_mask, discs, jnp.inf)
        gap = jnp.concatenate([gap, discs], axis=1)
    radii = jnp.array(diameters, gap.dtype) / 2
    count = jnp.sum(gap[:, :, None] < radii, axis=1)
    return jnp.minimum(count, cap) / cap
