"""Progress of a step: potential, approach to a target, direction of travel."""

import jax
import jax.numpy as jnp

from carpark_mj.config import WORLD_UNIT, RewardConfig
from carpark_mj.geometry import heading_error, move_forward, norm, reeds_shepp_length
from carpark_mj.types import Motion, Vehicle

NEARER = 1e-5 * WORLD_UNIT / 16  # m, 1e-5 points of Tanner's finer grid: rounding
ALIGNMENT_RANGE = 4.0  # m, at which the alignment reward has faded to 1/e
MOVING = 0.05  # m/s, slower cars have no direction of travel


def goal_potential(
    weights: RewardConfig,
    pose_w: jax.Array,
    goal_pose: jax.Array,
    distance: jax.Array | None = None,
    one_way: jax.Array | None = None,
) -> jax.Array:
    """Potential (...) of a pose: minus the weighted distance and misalignment to go.

    Progress terms are differences of this (undiscounted), so that no closed loop pays.
    The misalignment with the bay's axis, either way round if either end may go in
    first, counts more the nearer the goal is.

    Args:
        weights: of distance and misalignment.
        pose_w: (..., 3).
        goal_pose: (..., 3).
        distance: (...) distance to go [m]; None = straight.
        one_way: (...) bool, see `Transition.one_way`.
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
    motion: Motion,
    goal_pose: jax.Array,
    one_way: jax.Array | None = None,
) -> jax.Array:
    """Distances to go (...) [m], near the goal those of Reeds-Shepp paths.

    Args:
        reach: `RewardConfig.reeds_shepp_reach`.
        distance: (...) straight or along the lanes [m].
        car: (...) parameters.
        motion: (...) of the cars.
        goal_pose: (..., 3).
        one_way: (...) bool, see `Transition.one_way`.
    """
    radius = car.wheelbase / jnp.tan(car.max_steering)
    back = -car.centre_offset
    start = move_forward(motion.pose_w, back)
    turned = goal_pose + jnp.array([0.0, 0.0, jnp.pi])
    length = reeds_shepp_length(start, move_forward(goal_pose, back), radius)
    other = reeds_shepp_length(start, move_forward(turned, back), radius)
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
    both = norm(b) + norm(a)
    return gained > NEARER * both


def direction_of_travel(motion: Motion) -> jax.Array:
    """Sign (...) of the speed along the car's axis; 0 below `MOVING`."""
    return jnp.sign(motion.speed) * (jnp.abs(motion.speed) > MOVING)
