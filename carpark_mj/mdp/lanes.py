"""Driving against the direction of a lane."""

import math

import jax
import jax.numpy as jnp

from carpark_mj.layouts.lanes import lane_distance
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.metrics.episode import MOVING
from carpark_mj.types import Motion

# Beyond this angle to the lane's direction a car drives against it; up to it a car
# crosses the lane or turns in it, on its way into a bay or out of one.
AGAINST = math.radians(120.0)


def is_wrong_way(layout: Layout, vehicle: Motion) -> jax.Array:
    """Whether each agent (num_agents,) drives against the lanes it is in.

    It does if it moves, its centre is in a lane, and no lane there allows its
    direction of travel: that of its motion, not its heading, so that reversing counts
    by where the car goes. A lane allows any direction if it is not one-way, else those
    within `AGAINST` of its own. The halves of a two-way street are one-way lanes
    (`layouts.build.two_lanes`), so driving on its wrong side counts, too.
    """
    inside = lane_distance(layout, vehicle.pose_w) <= 0.0
    travel = vehicle.pose_w[:, 2] + jnp.where(vehicle.speed < 0.0, jnp.pi, 0.0)
    along = jnp.cos(travel[:, None] - layout.lane_pose[:, 2]) >= math.cos(AGAINST)
    allowed = inside & (along | ~layout.lane_one_way)
    moving = jnp.abs(vehicle.speed) > MOVING
    return moving & inside.any(axis=1) & ~allowed.any(axis=1)
