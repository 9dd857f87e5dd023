"""Reward terms by name; weights are data (`RewardConfig`).

Terms that are "sums" are paid a share each step so that a whole episode of
`max_steps` adds up to the weight, as in Tanner 2022. Of his program's terms those
are left out that none of his experiments uses.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import WORLD_UNIT, EnvConfig, RewardConfig
from carpark_mj.geometry import axis_angle_error, box_distance
from carpark_mj.geometry.broad_phase import box_gaps, is_crowded, least_near
from carpark_mj.types import Events, Motion

TERMS = (
    "park",
    "final_speed",
    "final_heading",
    "crash",
    "halt",
    "time",
    "progress",
    "approach",
    "smoothness",
    "closeness",
    "reverse",
)
NEARER = 1e-5 * WORLD_UNIT / 16  # m, 1e-5 points of his finer grid: less is rounding


@struct.dataclass
class Effort:
    """What cars did in a step, as shares of the most they can do; both (num_agents,).

    Attributes:
        turn: change of steering; on the grid, where none is, of heading.
        speed: at the end of the step, either way, of the higher of both limits.
    """

    turn: jax.Array
    speed: jax.Array


def effort(config: EnvConfig, before: Motion, after: Motion, vehicle: Any) -> Effort:
    """How hard agents (num_agents,) steered in a step, and how fast they are.

    Args:
        config: physics and its limits.
        before: the agents at the start of the step.
        after: at its end.
        vehicle: their `carpark_mj.vehicle.Vehicle`, whose limits hold off the grid.
    """
    ctrl_dt = config.sim.ctrl_dt
    if config.physics == "grid":
        grid = config.grid
        turn = jnp.abs(after.yaw_rate) * ctrl_dt
        most = grid.max_turn * 2 * math.pi / grid.headings
        level = grid.speed_step * grid.point_size / ctrl_dt
        top = level * max(grid.max_forward, grid.max_reverse)
    else:
        turn = jnp.abs(after.steering - before.steering)
        most = vehicle.steering_rate * ctrl_dt
        top = jnp.maximum(vehicle.max_speed, vehicle.max_reverse_speed)
    return Effort(turn=turn / most, speed=jnp.abs(after.speed) / top)


def term_names(lanes: bool = False) -> tuple[str, ...]:
    """Names of the terms of `reward_terms`, in a lot with lanes or without."""
    return (*TERMS, "wrong_way") if lanes else TERMS


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


def agent_clearance(vehicle: Motion) -> jax.Array:
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
    before: Motion,
    after: Motion,
    goal_pose: jax.Array,
    events: Events,
    effort: Effort,
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
        effort: of the step.
        max_steps: episode length the sums refer to.
        wrong_way: (num_agents,) bool, driving against the lanes; None without lanes.

    Returns:
        Named terms (num_agents,), weights and signs applied, in the order of
        `term_names`; 0 for a diverged car.
    """
    share = 1.0 / max_steps
    potential = goal_potential(config, after.pose_w, goal_pose) - goal_potential(
        config, before.pose_w, goal_pose
    )
    approach = jnp.where(is_nearer(before, after, goal_pose), 1.0, -1.0)
    too_close = jnp.maximum(1.0 - agent_clearance(after) / config.closeness_range, 0.0)
    turn = effort.turn * effort.speed if config.smoothness_by_speed else effort.turn
    across = axis_angle_error(after.pose_w[..., 2] - goal_pose[..., 2]) / (math.pi / 2)
    terms = {
        "park": config.park * events.parked,
        "final_speed": -config.final_speed * events.parked * effort.speed,
        "final_heading": -config.final_heading * events.parked * across,
        "crash": -config.crash * events.crashed,
        "halt": -config.halt * events.timed_out,
        "time": jnp.full_like(potential, -config.time * share),
        "progress": potential,
        "approach": config.approach * share * approach,
        "smoothness": -config.smoothness * share * turn,
        "closeness": -config.closeness * share * too_close,
        "reverse": -config.reverse * share * (after.speed < 0.0),
    }
    if wrong_way is not None:
        terms["wrong_way"] = -config.wrong_way * share * wrong_way
    return {
        name: jnp.where(events.diverged, 0.0, term).astype(jnp.float32)
        for name, term in terms.items()
    }


def is_nearer(before: Motion, after: Motion, goal_pose: jax.Array) -> jax.Array:
    """Whether cars (...) came nearer to their goals (..., 3) by more than `NEARER`.

    From the difference of the squared distances, (b - a)(b + a), which on the grid is
    exact in float32: going round the goal at the same distance is not coming nearer.
    """
    b = before.pose_w[..., :2] - goal_pose[..., :2]
    a = after.pose_w[..., :2] - goal_pose[..., :2]
    gained = jnp.sum((b - a) * (b + a), axis=-1)
    both = jnp.linalg.norm(b, axis=-1) + jnp.linalg.norm(a, axis=-1)
    return gained > NEARER * both
