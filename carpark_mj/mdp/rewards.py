"""The reward: named terms of a step, weighted and added.

`TERMS` are the library's, `carpark_mj.mdp.goal_rewards` adds those of goals that agents
choose, and `RewardConfig.extra` any that other code has registered. The order in which
they are added is that of `term_weights`.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import REWARD_TERMS, EnvConfig, RewardTerm
from carpark_mj.geometry import norm
from carpark_mj.layouts.routes import route_to
from carpark_mj.mdp.clearance import agent_clearance
from carpark_mj.mdp.goal_rewards import GOAL_TERMS, dynamic_progress, goal_weights
from carpark_mj.mdp.progress import goal_potential, mix_in_maneuver
from carpark_mj.types import Motion, Transition

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
    """Whether a weight is known to be 0; one that is traced may have any value."""
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
