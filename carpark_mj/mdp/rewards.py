"""The reward: named terms of a step, weighted and added.

`TERMS` are the library's, `GOAL_TERMS` those of goals that agents choose, and
`RewardConfig.extra` adds any that other code has registered. The order in which they
are added is that of `term_weights`.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import REWARD_TERMS, EnvConfig, RewardTerm
from carpark_mj.geometry import norm
from carpark_mj.layouts.routes import route_to
from carpark_mj.mdp.clearance import agent_clearance
from carpark_mj.mdp.progress import goal_potential, mix_in_maneuver
from carpark_mj.mdp.tracked_bays import target_bay
from carpark_mj.types import NO_BAY, Motion, Transition

CLOSENESS_RANGE = 3.0  # m, clearance between agents below which they are too close


def term_weights(config: EnvConfig) -> dict[str, float]:
    """Weights of all terms by name, which may be traced; those that are off are 0."""
    reward = config.reward
    weights: dict[str, float] = {name: getattr(reward, name) for name in TERMS}
    # Its two weights are in the potential.
    is_off = _is_off(reward.progress) and _is_off(reward.alignment)
    weights["progress"] = 0.0 if is_off else 1.0
    weights |= {key: w for key, w in reward.extra.items() if "." not in key}
    return weights | (goal_weights(config) if config.goals.dynamic else {})


def reward_terms(config: EnvConfig, transition: Transition) -> dict[str, jax.Array]:
    """The reward of a step, term by term.

    Args:
        config: weights, the limits that sums refer to, and the giving-way scheme.
        transition: the step.

    Returns:
        (num_agents,) float32 by the names of `term_weights`, weights and signs applied;
        0 for agents that had finished before, or whose physics diverged. Terms whose
        weights are known to be 0 are not computed.
    """
    pays = transition.before.active & ~transition.events.diverged

    def paid(name: str, weight: float) -> jax.Array:
        if _is_off(weight):
            return jnp.zeros(pays.shape, jnp.float32)
        term = TERMS.get(name) or GOAL_TERMS.get(name) or REWARD_TERMS[name]
        share = 1.0 / config.episode.max_steps if term.per_step else 1.0
        given = config.reward.parameters(name)
        value = term.value(config, transition, **given)
        term = term.sign * weight * share * value
        return jnp.where(pays, term, 0.0).astype(jnp.float32)

    return {name: paid(name, weight) for name, weight in term_weights(config).items()}


def _potential(config: EnvConfig, transition: Transition, motion: Motion) -> jax.Array:
    """Potential (num_agents,) of a motion with regard to the goals of the step."""
    weights, state, target = config.reward, transition.after, transition.target_pose
    distance = norm(motion.xy - target[:, :2])
    if weights.route:
        goal = transition.goal
        distance = route_to(state.routes, state.layout, motion.xy, goal).length
    if not _is_off(weights.reeds_shepp_reach):
        car = transition.before.physics.vehicle
        distance = mix_in_maneuver(
            weights.reeds_shepp_reach, distance, car, motion, target, transition.one_way
        )
    return goal_potential(weights, motion.pose_w, target, distance, transition.one_way)


def _is_off(weight: float) -> bool:
    """Whether a weight is known to be 0; a traced weight may have any value."""
    return not isinstance(weight, jax.Array) and weight == 0.0


def _progress(config: EnvConfig, transition: Transition) -> jax.Array:
    """Progress (num_agents,) towards the goals; its weights are in the potential."""
    if transition.goal_events is not None:
        return dynamic_progress(config, transition)
    after, before = transition.after.motion, transition.before.motion
    ended = _potential(config, transition, after)
    return ended - _potential(config, transition, before)


def _closeness(config: EnvConfig, transition: Transition) -> jax.Array:
    """Share (num_agents,) of the range by which the nearest agent is too close."""
    del config
    gap = agent_clearance(transition.after.motion) / CLOSENESS_RANGE
    return jnp.maximum(1.0 - gap, 0.0)


TERMS = {
    "park": RewardTerm(lambda config, step: step.events.parked),
    "crash": RewardTerm(lambda config, step: step.events.crashed, sign=-1),
    "time": RewardTerm(lambda config, step: 1.0, sign=-1, per_step=True),
    "progress": RewardTerm(_progress),
    "closeness": RewardTerm(_closeness, sign=-1, per_step=True),
}


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
