"""Progress of a step: potential, approach to a target, direction of travel, effort."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from carpark_mj.geometry import heading_error, move_forward, norm, reeds_shepp_length
from carpark_mj.layouts.routes import lane_distance
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.terminations import WORLD_UNIT
from carpark_mj.types import Motion, Transition, Vehicle

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig, RewardConfig

NEARER = 1e-5 * WORLD_UNIT / 16  # m, 1e-5 points of Tanner's finer grid: rounding
ALIGNMENT_RANGE = 4.0  # m, at which the alignment reward has faded to 1/e
MOVING = 0.05  # m/s, slower cars have no direction of travel
# Beyond this angle to the lane's direction a car drives against it; up to it a car
# crosses the lane or turns in it, on its way into a bay or out of one.
AGAINST = math.radians(120.0)


def goal_potential(
    weights: RewardConfig,
    pose_w: jax.Array,
    goal_pose: jax.Array,
    distance: jax.Array | None = None,
    one_way: jax.Array | None = None,
) -> jax.Array:
    """Potential (...) of a pose: minus the weighted distance and misalignment to go.

    Progress terms are undiscounted differences of it, so closed loops earn nothing. The
    misalignment with the bay's axis counts more the nearer the goal is; either way
    round is right if either end may go in first, see `Transition.one_way`. Without a
    `distance` (...) [m] the way to go is straight.
    """
    if distance is None:
        distance = norm(pose_w[..., :2] - goal_pose[..., :2])
    misalignment = heading_error(pose_w[..., 2] - goal_pose[..., 2], one_way)
    fading = jnp.exp(-distance / ALIGNMENT_RANGE)
    return -(weights.progress * distance + weights.alignment * misalignment * fading)


def mix_in_maneuver(
    reach: float,
    distance: jax.Array,
    car: Vehicle,
    pose_w: jax.Array,
    goal_pose: jax.Array,
    one_way: jax.Array | None = None,
) -> jax.Array:
    """Distances to go (...) [m], near the goal (`reach`) those of Reeds-Shepp paths."""
    radius = car.wheelbase / jnp.tan(car.max_steering)
    back = -car.centre_offset
    start = move_forward(pose_w, back)
    goals = jnp.stack([goal_pose, goal_pose + jnp.array([0.0, 0.0, jnp.pi])])
    lengths = reeds_shepp_length(start, move_forward(goals, back), radius)
    length, other = jnp.unstack(lengths)
    if one_way is not None:
        other = jnp.where(one_way, jnp.inf, other)
    length = jnp.minimum(length, other)
    width = jnp.maximum(0.75 * reach, 1e-6)  # a reach of 0 is nowhere, not NaN
    share = jnp.clip((reach - distance) / width, 0.0, 1.0)
    return distance + share * (length - distance)


def is_nearer(
    before_xy: jax.Array, after_xy: jax.Array, target_xy: jax.Array
) -> jax.Array:
    """Whether points (..., 2) came nearer to targets (..., 2) by more than `NEARER`.

    From the difference of the squared distances, (b - a)(b + a), which on the grid is
    exact in float32: going round the target at the same distance is not coming nearer.
    """
    b = before_xy - target_xy
    a = after_xy - target_xy
    gained = (b - a) * (b + a)
    gained = gained[..., 0] + gained[..., 1]
    return gained > NEARER * (norm(b) + norm(a))


def direction_of_travel(motion: Motion) -> jax.Array:
    """Sign (...) of the speed along the car's axis; 0 below `MOVING`."""
    return jnp.sign(motion.speed) * (jnp.abs(motion.speed) > MOVING)


def drives_wrong_way(layout: Layout, motion: Motion) -> jax.Array | None:
    """Whether each agent drives against the lanes it is in.

    An agent does if it moves, its centre is in a lane, and no lane there allows its
    direction of motion. The heading does not matter, so a reversing car counts by where
    it goes. A one-way lane, such as half of a street, allows directions within
    `AGAINST` of its own, any other lane all. (num_agents,) bool; None in lots that
    never have lanes.
    """
    if not layout.has_lanes:
        return None
    inside = lane_distance(layout, motion.pose_w) <= 0.0
    travel = motion.pose_w[:, 2] + jnp.where(motion.speed < 0.0, jnp.pi, 0.0)
    along = jnp.cos(travel[:, None] - layout.lane_pose[:, 2]) >= math.cos(AGAINST)
    allowed = inside & (along | ~layout.lane_one_way)
    moving = jnp.abs(motion.speed) > MOVING
    return moving & inside.any(axis=1) & ~allowed.any(axis=1)


def effort(config: EnvConfig, transition: Transition) -> tuple[jax.Array, jax.Array]:
    """Steering change and speed (num_agents,) of a step, as shares of the largest."""
    before, after = transition.before.motion, transition.after.motion
    vehicle, ctrl_dt = transition.before.physics.vehicle, config.sim.ctrl_dt
    physics = config.physics_config
    turn = physics.turn(before, after, ctrl_dt)
    top = physics.top_speed(vehicle, ctrl_dt)
    share = turn / physics.largest_turn(vehicle, ctrl_dt)
    return share, jnp.abs(after.speed) / top
