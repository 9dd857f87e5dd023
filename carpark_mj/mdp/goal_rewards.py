"""Reward terms that goals chosen by agents add or change; weights in `GoalRewards`."""

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.progress import goal_potential
from carpark_mj.mdp.tracked_bays import target_bay
from carpark_mj.types import NO_BAY, GoalEvents, Transition

GOAL_TERMS = (
    "continue_explore",
    "stop_explore",
    "continue_goal",
    "change_goal",
    "stop_goal",
    "lost_goal",
    "taken_goal",
)


def goal_terms(
    config: EnvConfig,
    transition: Transition,
    goals: GoalEvents,
    terms: dict[str, jax.Array],
) -> dict[str, jax.Array]:
    """All terms of a step with chosen goals.

    Agents that keep a bad goal, one that they should give up by the giving-way scheme,
    get `bad_goal` instead of `continue_goal`.

    Args:
        config: weights and the giving-way scheme.
        transition: the step.
        goals: what happened to the goals.
        terms: (num_agents,) those of driving, towards the goals chosen in the step.

    Returns:
        Named terms (num_agents,), weights and signs applied.
    """
    pay, scheme = config.reward.goals, config.giving_way
    kept = pay.continue_goal * goals.continue_goal
    terms = terms | {
        "progress": chosen_progress(config, transition),
        "approach": jnp.where(goals.exploring, 0.0, terms["approach"]),
        "continue_explore": pay.continue_explore * goals.continue_explore,
        "stop_explore": pay.stop_explore * goals.stop_explore,
        "continue_goal": kept,
        "change_goal": pay.change_goal * goals.change_goal,
        "stop_goal": pay.stop * goals.stop_goal,
        "lost_goal": pay.lost * goals.lost_untracked,
        "taken_goal": pay.taken_goal * goals.lost_taken,
    }
    if scheme.context is None:
        return terms
    bad = goals.contexts[scheme.context] & goals.continue_goal
    return terms | {
        "continue_goal": jnp.where(bad, 0.0, kept),
        "bad_goal": jnp.where(bad, scheme.bad_goal, 0.0),
    }


def chosen_progress(config: EnvConfig, transition: Transition) -> jax.Array:
    """Progress (num_agents,) when goals change, without a profit from any loop.

    Progress is measured towards the goal chosen in the step. Exploring agents get no
    positive progress, but moving away from the nearest tracked bay costs as much as
    approaching it would have paid; otherwise an agent could approach with a goal and
    leave without one, for ever. Changing to a farther goal costs the potential lost, a
    nearer goal pays nothing. So the terms of a loop that ends in the pose and with the
    goal it began with add up to at most 0.
    """
    before, layout = transition.before, transition.before.layout
    tracked, weights = before.tracked_bays, config.reward
    assert tracked is not None
    pose, after_pose = before.motion.pose_w, transition.after.motion.pose_w
    old, _ = target_bay(layout, before.goal, tracked, pose[:, :2])
    new, any_bay = target_bay(layout, transition.goal, tracked, pose[:, :2])
    exploring = transition.goal == NO_BAY
    one_way = layout.one_way

    def potential(pose: jax.Array, bay: jax.Array) -> jax.Array:
        only = None if one_way is None else one_way[bay]
        return goal_potential(weights, pose, layout.parked_pose[bay], one_way=only)

    # Of an explorer's nearest bay at the end: another may have become that.
    ended = goal_potential(
        weights, after_pose, transition.target_pose, one_way=transition.one_way
    )
    start = potential(pose, new)
    moved = jnp.where(exploring, ended, potential(after_pose, new)) - start
    moved = jnp.where(exploring, jnp.minimum(moved, 0.0), moved)
    switched = start - potential(pose, old)
    return jnp.where(any_bay, moved + jnp.minimum(switched, 0.0), 0.0)
