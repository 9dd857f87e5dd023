"""Agents in search of a bay: their goals and the bays they track, through one step.

The step begins with `choose`. When it has ended, and episodes with it, agents
`look_round`: see `dynamic_goals`, `giving_way` and `spaces` for the rules.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.mdp.chosen_goals import (
    GoalEvents,
    choose_goals,
    goal_events,
    lose_goals,
    taken_by_others,
)
from carpark_mj.mdp.giving_way import Contexts, find_contexts, goals_in_turn
from carpark_mj.mdp.spawning.exploring import ExploringStart, first_goals
from carpark_mj.mdp.tracked_bays import free_bays, track_spaces
from carpark_mj.state import State
from carpark_mj.types import Events


def choose(state: State, choice: jax.Array) -> State:
    """Agents that have not finished choose goals; `choice` (num_agents,) int32."""
    assert state.spaces is not None
    old = state.occupancy.goal
    goal = choose_goals(old, state.spaces, choice, state.layout.num_bays)
    return _with_goal(state, jnp.where(state.active, goal, old))


def look_round(state: State, fitting: jax.Array | None) -> tuple[State, jax.Array]:
    """Agents look for the free bays nearest to them.

    Those that have finished keep their goals, and in these bays they stand.

    Args:
        state: of a lot.
        fitting: (num_agents, bays) bool, bays that can be an agent's goal; None = all.

    Returns:
        The state, and (num_agents,) bool, whose goal is not among them any more.
    """
    assert state.spaces is not None
    layout, goal = state.layout, state.occupancy.goal
    standing = jnp.where(state.active, layout.num_bays, goal)
    free = free_bays(layout, jnp.concatenate([state.occupancy.parked_bay, standing]))
    if fitting is not None:
        free = free & fitting
    spaces = track_spaces(layout, state.vehicle.pose_w[:, :2], free, state.spaces)
    tracked = (spaces == goal[:, None]).any(axis=1)
    goal, lost = lose_goals(goal, state.active & ~tracked, layout.num_bays)
    return _with_goal(dataclasses.replace(state, spaces=spaces), goal), lost


def stay(state: State, events: Events) -> tuple[State, jax.Array]:
    """Agents that have finished stay: those that have parked in their bays.

    Returns:
        The state, and (num_agents,) bool, whose goal somebody else has parked in;
        nobody's while goals are fixed.
    """
    if state.spaces is None:
        return state, jnp.zeros_like(events.parked)
    goal, num_bays = state.occupancy.goal, state.layout.num_bays
    taken = taken_by_others(goal, events.parked) & ~events.done
    gone = taken | (events.done & ~events.parked)
    return _with_goal(state, jnp.where(gone, num_bays, goal)), taken


def set_out(
    state: State, fresh: jax.Array, starts: tuple[ExploringStart, jax.Array] | None
) -> State:
    """Agents that have just started get the goals to start with, if any.

    Args:
        state: when they have looked round.
        fresh: (num_agents,) bool, who has started.
        starts: how, and a key; None while nobody starts.
    """
    if starts is None or state.spaces is None:
        return state
    begun, key = starts
    goal, num_bays = state.occupancy.goal, state.layout.num_bays
    goal = first_goals(begun, state.spaces, goal, fresh, num_bays, key)
    return _with_goal(state, goal)


def review(
    before: State,
    chosen: jax.Array,
    after: State,
    events: Events,
    taken: jax.Array,
    fitting: jax.Array | None,
    seen: jax.Array,
) -> tuple[State, GoalEvents, Contexts]:
    """Agents look round at the end of a step, in which these goals were lost.

    Args:
        before: at the start of the step, goals not chosen yet.
        chosen: (num_agents,) goals chosen.
        after: at its end, when episodes have ended and begun.
        events: of the step.
        taken: (num_agents,) bool, whose goal somebody else has parked in.
        fitting: see `look_round`.
        seen: (num_agents, num_agents) bool, who tracked whom when they chose.

    Returns:
        The state, what became of the goals, and who should have given way.
    """
    after, untracked = look_round(after, fitting)
    goal, layout = before.occupancy.goal, before.layout
    named = goal_events(
        goal, chosen, untracked & ~events.done, taken, before.active, layout.num_bays
    )
    contexts = find_contexts(
        before.vehicle.pose_w,
        goal,
        goals_in_turn(goal, chosen),
        layout.bay_pose,
        seen,
        before.active,
    )
    return after, named, contexts


def _with_goal(state: State, goal: jax.Array) -> State:
    occupancy = dataclasses.replace(state.occupancy, goal=goal)
    return dataclasses.replace(state, occupancy=occupancy)
