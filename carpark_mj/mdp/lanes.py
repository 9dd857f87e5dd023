"""Lanes: which one a car is in, and whether it drives against it."""

import math

import jax
import jax.numpy as jnp

from carpark_mj.geometry import point_box_distance
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.progress import MOVING
from carpark_mj.types import Motion

# Beyond this angle to the lane's direction a car drives against it; up to it a car
# crosses the lane or turns in it, on its way into a bay or out of one.
AGAINST = math.radians(120.0)


def has_lanes(layout: Layout) -> bool:
    """Whether lots of this shape can have lanes."""
    return layout.lane_mask.shape[-1] > 0


def nearest_lane(layout: Layout, pose_w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The lane of each car: the one its centre is in, or else the nearest.

    Where lanes overlap (at crossings), the one that points most as the car does.

    Args:
        layout: the lot.
        pose_w: (num_agents, 3) poses.

    Returns:
        (num_agents,) int index and (num_agents,) bool, whether the lot has a lane.
    """
    gap = _gaps(layout, pose_w)
    nearest = gap <= jnp.min(gap, axis=1, keepdims=True)
    alike = jnp.cos(pose_w[:, None, 2] - layout.lane_pose[:, 2])
    index = jnp.argmax(jnp.where(nearest, alike, -jnp.inf), axis=1)
    return index, jnp.broadcast_to(layout.lane_mask.any(), index.shape)


def is_wrong_way(layout: Layout, vehicle: Motion) -> jax.Array:
    """Whether each agent (num_agents,) drives against the lanes it is in.

    It does if it moves, its centre is in a lane, and no lane there allows its
    direction of travel: that of its motion, not its heading, so that reversing counts
    by where the car goes. A lane allows any direction if it is not one-way, else those
    within `AGAINST` of its own. The halves of a two-way street are one-way lanes
    (`layouts.build.two_lanes`), so driving on its wrong side counts, too.
    """
    inside = _gaps(layout, vehicle.pose_w) <= 0.0
    travel = vehicle.pose_w[:, 2] + jnp.where(vehicle.speed < 0.0, jnp.pi, 0.0)
    along = jnp.cos(travel[:, None] - layout.lane_pose[:, 2]) >= math.cos(AGAINST)
    allowed = inside & (along | ~layout.lane_one_way)
    moving = jnp.abs(vehicle.speed) > MOVING
    return moving & inside.any(axis=1) & ~allowed.any(axis=1)


def _gaps(layout: Layout, pose_w: jax.Array) -> jax.Array:
    """Distances (num_agents, lanes) [m] to the lanes; 0 inside, inf for padding."""
    gap = point_box_distance(pose_w[:, None, :2], layout.lane_pose, layout.lane_size)
    return jnp.where(layout.lane_mask, gap, jnp.inf)
