"""Driving against the direction of a lane."""

import math

import jax
import jax.numpy as jnp

from carpark_mj.layouts.lanes import has_lanes, lane_distance
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.progress import MOVING
from carpark_mj.types import Motion

# Beyond this angle to the lane's direction a car drives against it; up to it a car
# crosses the lane or turns in it, on its way into a bay or out of one.
AGAINST = math.radians(120.0)


def drives_wrong_way(layout: Layout, motion: Motion) -> jax.Array | None:
    """Whether each agent drives against the lanes it is in.

    It does if it moves, its centre is in a lane, and no lane there allows its
    direction of travel: that of its motion, not its heading, so that reversing counts
    by where the car goes. A lane allows any direction if it is not one-way, else those
    within `AGAINST` of its own. The halves of a two-way street are one-way lanes
    (`layouts.build.two_lanes`), so driving on its wrong side counts, too.

    Returns:
        (num_agents,) bool; None in lots that never have lanes.
    """
    if not has_lanes(layout):
        return None
    inside = lane_distance(layout, motion.pose_w) <= 0.0
    travel = motion.pose_w[:, 2] + jnp.where(motion.speed < 0.0, jnp.pi, 0.0)
    along = jnp.cos(travel[:, None] - layout.lane_pose[:, 2]) >= math.cos(AGAINST)
    allowed = inside & (along | ~layout.lane_one_way)
    moving = jnp.abs(motion.speed) > MOVING
    return moving & inside.any(axis=1) & ~allowed.any(axis=1)
