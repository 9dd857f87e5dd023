"""Distances of cars to lanes, and the lane of each car."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import point_box_distance
from carpark_mj.layouts.types import Layout


def has_lanes(layout: Layout) -> bool:
    """Whether lots of this shape can have lanes."""
    return layout.lane_mask.shape[-1] > 0


def lane_distance(layout: Layout, pose_w: jax.Array) -> jax.Array:
    """Distance of each car's centre to each lane.

    Args:
        layout: the lot.
        pose_w: (num_agents, 3) poses.

    Returns:
        (num_agents, lanes) [m]; 0 inside, inf for padding.
    """
    distance = point_box_distance(
        pose_w[:, None, :2], layout.lane_pose, layout.lane_size
    )
    return jnp.where(layout.lane_mask, distance, jnp.inf)


def nearest_lane(layout: Layout, pose_w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The lane of each car: the one its centre is in, or else the nearest.

    Where lanes overlap (at crossings), the one that points most as the car does.

    Args:
        layout: the lot.
        pose_w: (num_agents, 3) poses.

    Returns:
        (num_agents,) int index and (num_agents,) bool, whether the lot has a lane.
    """
    distance = lane_distance(layout, pose_w)
    nearest = distance <= jnp.min(distance, axis=1, keepdims=True)
    alike = jnp.cos(pose_w[:, None, 2] - layout.lane_pose[:, 2])
    index = jnp.argmax(jnp.where(nearest, alike, -jnp.inf), axis=1)
    return index, jnp.broadcast_to(layout.lane_mask.any(), index.shape)
