"""Reward terms for goals that agents choose; weights in `GoalRewards`."""

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, RewardTerm
from carpark_mj.mdp.progress import goal_potential
from carpark_mj.mdp.tracked_bays import target_bay
from carpark_mj.types import NO_BAY, Transition


def goal_weights(config: EnvConfig) -> dict[str, float]:
    """Weights of `GOAL_TERMS`; `bad_goal` only where there are bad goals."""
    pay, scheme = config.reward.goals, config.giving_way
    weights: dict[str, float] = {
        "continue_explore": pay.continue_explore,
        "stop_explore": pay.stop_explore,
        "continue_goal": pay.continue_goal,
        "change_goal": pay.change_goal,
        "stop_goal": pay.stop,
        "lost_goal": pay.stop,
    }
    return (
        weights if scheme.context is None else weights | {"bad_goal": scheme.bad_goal}
    )


def _event(name: str) -> RewardTerm:
    """A term that is paid when something happens to a goal."""
    return RewardTerm(lambda config, step: getattr(step.goal_events, name))


def _keeps_bad(config: EnvConfig, step: Transition) -> jax.Array:
    """Whether agents (num_agents,) keep goals that the scheme says to give up."""
    goals, context = step.goal_events, config.giving_way.context
    assert goals is not None
    bad = False if context is None else goals.contexts[context]
    return goals.continue_goal & bad


def _keeps_good(config: EnvConfig, step: Transition) -> jax.Array:
    """Whether agents (num_agents,) keep other goals."""
    assert step.goal_events is not None
    return step.goal_events.continue_goal & ~_keeps_bad(config, step)


GOAL_TERMS = {
    "continue_explore": _event("continue_explore"),
    "stop_explore": _event("stop_explore"),
    "continue_goal": RewardTerm(_keeps_good),
    "change_goal": _event("change_goal"),
    "stop_goal": _event("stop_goal"),
    "lost_goal": _event("lost_untracked"),
    "bad_goal": RewardTerm(_keeps_bad),
}


def dynamic_progress(config: EnvConfig, transition: Transition) -> jax.Array:
    """Progress (num_agents,) when goals change; no cycle of goals is profitable.

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
