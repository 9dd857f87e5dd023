"""What the agents of a lot earn in a step, put together from its states."""

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.mdp import rewards
from carpark_mj.mdp.chosen_goals import GoalEvents, aims
from carpark_mj.mdp.giving_way import Contexts, enforce
from carpark_mj.mdp.goal_rewards import dynamic_progress, dynamic_terms
from carpark_mj.state import State
from carpark_mj.types import Events, Motion


def goal_poses(state: State, vehicle: Motion) -> jax.Array:
    """Poses (num_agents, 3) of the goals; see `aims` for agents that explore."""
    layout, goal = state.layout, state.occupancy.goal
    if state.spaces is None:
        return layout.bay_pose[goal]
    return aims(layout, goal, state.spaces, vehicle.pose_w[:, :2])[0]


def step_rewards(
    config: EnvConfig,
    before: State,
    state: State,
    vehicle: Motion,
    goal_pose: jax.Array,
    events: Events,
    wrong_way: jax.Array | None,
    goals: GoalEvents | None,
    contexts: Contexts | None,
) -> dict[str, jax.Array]:
    """The reward of a step by term; 0 for those that had finished before.

    Args:
        config: weights, limits, and the scheme of giving way.
        before: at the start of the step.
        state: the same once goals are chosen.
        vehicle: the agents at the end of the step, before any respawn.
        goal_pose: (num_agents, 3) goals held during the step.
        events: of the step.
        wrong_way: (num_agents,) bool, driving against the lanes; None without lanes.
        goals: what became of the goals; None while they are fixed.
        contexts: who should have given way; None likewise.
    """
    cars = state.physics.vehicle
    terms = rewards.reward_terms(
        config.reward,
        state.vehicle,
        vehicle,
        goal_pose,
        events,
        rewards.effort(config, state.vehicle, vehicle, cars),
        config.episode.max_steps,
        wrong_way,
    )
    if goals is not None and contexts is not None and state.spaces is not None:
        progress = dynamic_progress(
            config.reward,
            state.layout,
            state.spaces,
            (before.occupancy.goal, state.occupancy.goal),
            state.vehicle,
            vehicle,
        )
        terms = dynamic_terms(config.reward, terms, progress, goals, events.diverged)
        kept = goals.continue_goal & ~events.diverged
        terms = enforce(config.giving_way, contexts, kept, terms)
    return {name: jnp.where(state.active, term, 0.0) for name, term in terms.items()}
