"""Goals that agents choose themselves: explore, or head for a bay they track.

Every agent chooses at the start of a step. Its options do not depend on the choices of
the others, so their order does not matter. At the end of the step agents lose goals in
which another agent has parked, and goals that are no longer among their tracked bays.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.bays import bay_fits
from carpark_mj.mdp.giving_way import find_contexts
from carpark_mj.mdp.spawning.draws import draw_uniform
from carpark_mj.mdp.spawning.exploring import first_goals, place_exploring
from carpark_mj.mdp.spawning.placing import Placing, SpawnInputs, surroundings
from carpark_mj.mdp.spawning.poses import (
    random_pose,
    redraw,
    spawn_shapes,
    split_redraws,
)
from carpark_mj.mdp.tracked_bays import target_bay, update_tracked_bays
from carpark_mj.observations.tracked import tracks
from carpark_mj.types import NO_BAY, Events, GoalEvents, State


class DynamicGoals:
    """Goals behind the `Goals` interface that agents choose at every step."""

    def __init__(self, config: EnvConfig) -> None:
        """Takes the rules."""
        self._config = config

    def place_first(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> Placing:
        """A random start, of any kind with `SpawnConfig.kinds_at_reset`; no goal."""
        around = surroundings(inputs, placing, agent)
        around = dataclasses.replace(around, others=~placing.waiting)
        spawn = self._config.spawn
        if spawn.kinds_at_reset:
            return place_exploring(spawn, inputs, placing, around, key)
        key, again = split_redraws(spawn, key)
        draws = draw_uniform(spawn_shapes(spawn), key)
        pose = random_pose(spawn, inputs.layout, around, draws)
        pose = redraw(spawn, inputs.layout, around, pose, again)
        return placing.set(agent, pose_w=pose)

    def place(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> Placing:
        """Sends the agent exploring, from a pose that may be close to a bay."""
        placing = placing.set(agent, goal=NO_BAY)
        around = surroundings(inputs, placing, agent)
        return place_exploring(self._config.spawn, inputs, placing, around, key)

    def init_tracked_bays(self) -> jax.Array:
        """Empty slots (num_agents, num_tracked_bays) int32."""
        shape = (self._config.num_agents, self._config.goals.num_tracked_bays)
        return jnp.full(shape, NO_BAY, jnp.int32)

    def track(self, state: State) -> State:
        """Updates tracked bays; goals that are no longer among them are lost."""
        by_distance = self._config.goals.slots_by_distance
        state = update_tracked_bays(state, self._usable_bays(state), by_distance)
        assert state.tracked_bays is not None
        lost = state.active & untracked(state.goal, state.tracked_bays)
        goal = jnp.where(lost, NO_BAY, state.goal)
        return dataclasses.replace(state, goal=goal)

    def choose(self, state: State, choice: jax.Array | None) -> State:
        """Goals of the agents that have not finished, by their choices."""
        assert choice is not None
        assert state.tracked_bays is not None
        chosen = choose_goals(state.goal, state.tracked_bays, choice)
        goal = jnp.where(state.active, chosen, state.goal)
        return dataclasses.replace(state, goal=goal)

    def target_bay(self, state: State) -> jax.Array:
        """(num_agents,) goals, or the nearest bay tracked."""
        tracked, xy = state.tracked_bays, state.motion.xy
        assert tracked is not None
        return target_bay(state.layout, state.goal, tracked, xy)[0]

    def update(
        self, before: State, after: State, events: Events
    ) -> tuple[State, GoalEvents]:
        """Updates tracked bays and drops lost goals at the end of a step."""
        taken = taken_by_others(after.goal, events.parked) & ~events.done
        # Where finished agents stay, those that have parked stand in their bays.
        respawn = self._config.episode.respawn
        leaves = events.done if respawn else events.done & ~events.parked
        goal = jnp.where(taken | leaves, NO_BAY, after.goal)
        state = dataclasses.replace(after, goal=goal)
        tracking = self.track(state)
        lost = state.goal != tracking.goal
        return tracking, self._name_events(before, after.goal, taken, lost)

    def _name_events(
        self, before: State, chosen: jax.Array, taken: jax.Array, lost: jax.Array
    ) -> GoalEvents:
        """What happened to goals; all False for agents that had finished."""
        old, active = before.goal, before.active
        had, has = active & (old != NO_BAY), active & (chosen != NO_BAY)
        return GoalEvents(
            continue_explore=active & ~had & ~has,
            stop_explore=~had & has,
            continue_goal=had & has & (old == chosen),
            change_goal=had & has & (old != chosen),
            stop_goal=had & ~has,
            lost_untracked=lost,
            lost_taken=taken,
            contexts=find_contexts(before, chosen, tracks(self._config, before)),
        )

    def begin(
        self, state: State, placing: Placing, begun: jax.Array, key: jax.Array | None
    ) -> State:
        """Agents that begin track bays from where they stand, and may have a goal."""
        assert state.tracked_bays is not None
        tracked = jnp.where(begun[:, None], NO_BAY, state.tracked_bays)
        state = self.track(dataclasses.replace(state, tracked_bays=tracked))
        if key is None:
            return state
        assert state.tracked_bays is not None
        goal = first_goals(placing, state.tracked_bays, state.goal, begun, key)
        return dataclasses.replace(state, goal=goal)

    def _usable_bays(self, state: State) -> jax.Array | None:
        """Bays (num_agents, bays) that agents can track as goals; None = all."""
        layout, config = state.layout, self._config
        size = state.physics.vehicle.size
        usable = bay_fits(config, layout, size, state.parked_cars.size).agents
        seen = config.observation.bays_in_view(state)
        if seen is None:
            return usable
        return seen if usable is None else seen & usable


def choose_goals(
    goal: jax.Array, tracked_bays: jax.Array, choice: jax.Array
) -> jax.Array:
    """Applies the agents' choices.

    Args:
        goal: (num_agents,) int32 goals so far.
        tracked_bays: (num_agents, num_tracked_bays) int32.
        choice: (num_agents,) int, 0 = explore, k = the bay in slot k - 1; an empty
            slot, and any other number, keeps the goal.

    Returns:
        (num_agents,) int32 goals.
    """
    number = jnp.arange(1, tracked_bays.shape[1] + 1)
    here = (choice[:, None] == number) & (tracked_bays != NO_BAY)
    chosen = jnp.min(jnp.where(here, tracked_bays, NO_BAY), axis=1)
    chosen = jnp.where(here.any(axis=1), chosen, goal)
    return jnp.where(choice == 0, NO_BAY, chosen).astype(jnp.int32)


def taken_by_others(goal: jax.Array, parked: jax.Array) -> jax.Array:
    """Agents whose goal is a bay where another agent has just parked.

    Args:
        goal: (num_agents,) int32.
        parked: (num_agents,) bool, parked in this step.

    Returns:
        (num_agents,) bool.
    """
    same = (goal[:, None] == goal) & ~jnp.eye(goal.shape[0], dtype=bool)
    return (same & parked).any(axis=1) & ~parked


def untracked(goal: jax.Array, tracked_bays: jax.Array) -> jax.Array:
    """(num_agents,) bool, agents whose goal is not among the bays they track."""
    return (goal != NO_BAY) & ~(tracked_bays == goal[:, None]).any(axis=1)
