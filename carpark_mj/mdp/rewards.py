"""Reward terms by name; weights are data (`RewardConfig`).

Terms that are "sums" are divided by `max_steps`, so that a full episode adds up to the
weight, as in Tanner 2022.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.geometry import heading_error, norm
from carpark_mj.layouts.lanes import has_lanes
from carpark_mj.layouts.routes import way_to
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.clearance import agent_clearance
from carpark_mj.mdp.goal_rewards import GOAL_TERMS, goal_terms
from carpark_mj.mdp.progress import (
    direction_of_travel,
    goal_potential,
    is_nearer,
    mix_in_maneuver,
)
from carpark_mj.types import Motion, Transition

TERMS = (
    "park",
    "final_speed",
    "final_heading",
    "crash",
    "timeout",
    "time",
    "progress",
    "approach",
    "smoothness",
    "closeness",
    "reverse",
)


def term_names(config: EnvConfig, layout: Layout) -> tuple[str, ...]:
    """Names of the terms that `reward_terms` pays in a lot, in its order."""
    names = TERMS
    if has_lanes(layout):
        names += ("wrong_way",)
    if config.goals.dynamic:
        names += GOAL_TERMS
    if config.giving_way.context is not None:
        names += ("bad_goal",)
    return names


def reward_terms(config: EnvConfig, transition: Transition) -> dict[str, jax.Array]:
    """The reward of a step, term by term.

    Args:
        config: weights, the limits that sums refer to, and the giving-way scheme.
        transition: the step.

    Returns:
        (num_agents,) float32 by the names of `term_names`, weights and signs applied;
        0 for agents that had finished before, or whose physics diverged.
    """
    terms = _drive_terms(config, transition)
    if transition.goal_events is not None:
        terms = goal_terms(config, transition, transition.goal_events, terms)
    pays = transition.before.active & ~transition.events.diverged
    return {
        name: jnp.where(pays, term, 0.0).astype(jnp.float32)
        for name, term in terms.items()
    }


class Effort(NamedTuple):
    """Steering change and speed of a step, as shares of the most; (num_agents,) each.

    Attributes:
        turn: what `PhysicsConfig.turn` says, over the largest.
        speed: absolute speed at the end of the step over the higher of both limits.
    """

    turn: jax.Array
    speed: jax.Array


def effort(config: EnvConfig, transition: Transition) -> Effort:
    """How hard agents steered in a step, and how fast they are."""
    before, after = transition.before.motion, transition.after.motion
    vehicle, ctrl_dt = transition.before.physics.vehicle, config.sim.ctrl_dt
    physics = config.physics_config
    turn, top = (
        physics.turn(before, after, ctrl_dt),
        physics.top_speed(vehicle, ctrl_dt),
    )
    return Effort(
        turn=turn / physics.largest_turn(vehicle, ctrl_dt),
        speed=jnp.abs(after.speed) / top,
    )


def _potential(config: EnvConfig, transition: Transition, motion: Motion) -> jax.Array:
    """Potential (num_agents,) of a motion with regard to the goals of the step."""
    weights, state, target = config.reward, transition.after, transition.target_pose
    distance = norm(motion.xy - target[:, :2])
    if weights.route:
        goal = transition.goal
        distance = way_to(state.routes, state.layout, motion.xy, goal).length
    if not _is_off(weights.reeds_shepp):
        car = transition.before.physics.vehicle
        distance = mix_in_maneuver(
            weights.reeds_shepp, distance, car, motion, target, transition.one_way
        )
    return goal_potential(weights, motion.pose_w, target, distance, transition.one_way)


def _is_off(weight: float) -> bool:
    """Whether a weight is known to be 0; one that is traced may have any value."""
    return not isinstance(weight, jax.Array) and weight == 0.0


def _closeness(config: EnvConfig, motion: Motion) -> jax.Array:
    """The term `closeness` (num_agents,): tests of all pairs, but where it is off."""
    weights = config.reward
    if _is_off(weights.closeness):
        return jnp.zeros_like(motion.speed)
    gap = agent_clearance(motion) / weights.closeness_range
    share = 1.0 / config.episode.max_steps
    return -weights.closeness * share * jnp.maximum(1.0 - gap, 0.0)


def _drive_terms(config: EnvConfig, transition: Transition) -> dict[str, jax.Array]:
    weights, share = config.reward, 1.0 / config.episode.max_steps
    before, after = transition.before.motion, transition.after.motion
    events, target = transition.events, transition.target_pose
    used = effort(config, transition)
    progress = _potential(config, transition, after) - _potential(
        config, transition, before
    )
    nearer = is_nearer(before.xy, after.xy, target[:, :2])
    turn = used.turn * used.speed if weights.smoothness_by_speed else used.turn
    off = heading_error(after.pose_w[..., 2] - target[..., 2], transition.one_way)
    across = off / (math.pi / 2)
    terms = {
        "park": weights.park * events.parked,
        "final_speed": -weights.final_speed * events.parked * used.speed,
        "final_heading": -weights.final_heading * events.parked * across,
        "crash": -weights.crash * events.crashed,
        "timeout": -weights.timeout * events.timed_out,
        "time": jnp.full_like(progress, -weights.time * share),
        "progress": progress,
        "approach": weights.approach * share * jnp.where(nearer, 1.0, -1.0),
        "smoothness": -weights.smoothness * share * turn,
        "closeness": _closeness(config, after),
        "reverse": -weights.reverse * share * (direction_of_travel(after) < 0.0),
    }
    if transition.wrong_way is not None:
        terms["wrong_way"] = -weights.wrong_way * share * transition.wrong_way
    return terms
