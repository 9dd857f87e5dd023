"""Reward terms by name; weights are data (`RewardConfig`).

Terms that are "sums" are paid a share each step so that a whole episode of
`max_steps` adds up to the weight, as in Tanner 2022.
"""

import jax
import jax.numpy as jnp

from carpark_mj.broad_phase import box_gaps, is_crowded, least_near
from carpark_mj.config import RewardConfig
from carpark_mj.geometry import axis_angle_error, box_distance
from carpark_mj.types import Events, VehicleState


def goal_potential(
    config: RewardConfig, pose_w: jax.Array, goal_pose: jax.Array
) -> jax.Array:
    """Potential (...) of a pose: minus the weighted way still to go.

    Progress terms are differences of this (undiscounted), so that no closed loop pays.
    The misalignment with the bay's axis, either way round, counts more the nearer the
    goal is.
    """
    distance = jnp.linalg.norm(pose_w[..., :2] - goal_pose[..., :2], axis=-1)
    misalignment = axis_angle_error(pose_w[..., 2] - goal_pose[..., 2])
    fading = jnp.exp(-distance / config.alignment_range)
    return -(config.progress * distance + config.alignment * misalignment * fading)


def agent_clearance(vehicle: VehicleState) -> jax.Array:
    """Gap (num_agents,) [m] from each agent to the nearest other; inf if alone."""
    pose, size = vehicle.pose_w, vehicle.size
    own = jnp.eye(pose.shape[0], dtype=bool)
    if not is_crowded(*own.shape):
        gap = box_distance(pose[:, None], size[:, None], pose, size)
        return jnp.min(jnp.where(own, jnp.inf, gap), axis=1)

    def find(index: jax.Array) -> jax.Array:
        return box_distance(pose[:, None], size[:, None], pose[index], size[index])

    reach = jnp.linalg.norm(size, axis=-1) / 2
    bound = box_gaps(pose[:, :2], pose, size) - reach[:, None]
    bound = jnp.where(own, jnp.inf, bound)
    return least_near(bound, find, jnp.inf, chunk=2)


def reward_terms(
    config: RewardConfig,
    before: VehicleState,
    after: VehicleState,
    goal_pose: jax.Array,
    events: Events,
    max_steering_change: jax.Array,
    max_steps: int,
    wrong_way: jax.Array | None = None,
) -> dict[str, jax.Array]:
    """The reward of one step, term by term.

    Args:
        config: weights.
        before: the agents (num_agents,) at the start of the step.
        after: at its end, before any respawn.
        goal_pose: (num_agents, 3) goals held during the step.
        events: of the step.
        max_steering_change: (num_agents,) largest possible in one step [rad].
        max_steps: episode length the sums refer to.
        wrong_way: (num_agents,) bool, driving against the lanes; None without lanes.

    Returns:
        Named terms (num_agents,), weights and signs applied; 0 for a diverged car.
    """
    share = 1.0 / max_steps

    def distance(vehicle: VehicleState) -> jax.Array:
        return jnp.linalg.norm(vehicle.pose_w[..., :2] - goal_pose[..., :2], axis=-1)

    potential = goal_potential(config, after.pose_w, goal_pose) - goal_potential(
        config, before.pose_w, goal_pose
    )
    nearer = distance(after) < distance(before)
    too_close = jnp.maximum(1.0 - agent_clearance(after) / config.closeness_range, 0.0)
    steered = jnp.abs(after.steering - before.steering) / max_steering_change
    terms = {
        "park": config.park * events.parked,
        "crash": -config.crash * events.crashed,
        "time": jnp.full_like(potential, -config.time * share),
        "progress": potential,
        "approach": config.approach * share * jnp.where(nearer, 1.0, -1.0),
        "smoothness": -config.smoothness * share * steered,
        "closeness": -config.closeness * share * too_close,
        "reverse": -config.reverse * share * (after.speed < 0.0),
    }
    if wrong_way is not None:
        terms["wrong_way"] = -config.wrong_way * share * wrong_way
    return {
        name: jnp.where(events.diverged, 0.0, term).astype(jnp.float32)
        for name, term in terms.items()
    }
