"""What an environment carries from step to step, and what a step returns."""

from typing import Any

import jax
from flax import struct

from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.chosen_goals import GoalEvents
from carpark_mj.mdp.goals import Occupancy
from carpark_mj.mdp.metrics.episode import EpisodeStats
from carpark_mj.observations.sensors import Sensors
from carpark_mj.types import Events, Motion


@struct.dataclass
class State:
    """Everything about one lot at one time.

    Attributes:
        physics: state of the back end, (num_agents,) cars.
        vehicle: the agents' motion, read from it.
        layout: the lot.
        occupancy: goals and parked cars.
        spaces: (num_agents, num_spaces) int32 free bays each agent tracks,
            `layout.num_bays` where there is none; None while goals are fixed.
        ring_history: what rings counted before, see `observations.rings.init_history`.
        parked_size: (num_parked_cars, 2) footprints [m].
        parked_offset: (num_parked_cars, 3) where they stand in their bays if these
            allow it, see `fit.stand_in_bay`; None while all stand in the middle.
        step: (num_agents,) int32 control steps made in the running episodes.
        active: (num_agents,) bool; False once finished when nobody respawns.
        stats: per-episode sums.
        sensors: the agents' sensors; None while what they observe is the truth.
        key: randomness of this lot.
    """

    physics: Any
    vehicle: Motion
    layout: Layout
    occupancy: Occupancy
    spaces: jax.Array | None
    ring_history: jax.Array | None
    parked_size: jax.Array
    parked_offset: jax.Array | None
    step: jax.Array
    active: jax.Array
    stats: EpisodeStats
    sensors: Sensors | None
    key: jax.Array


@struct.dataclass
class TimeStep:
    """What a step tells the agents; all leading dimension (num_agents,).

    Attributes:
        observation: (num_agents, observation_size); of the new episode where an agent
            has respawned.
        reward: (num_agents,).
        terminated: (num_agents,) bool, parked or crashed: the cost to go is zero.
        truncated: (num_agents,) bool, timed out or diverged: it is not.
        events: what happened.
        metrics: per-episode numbers, valid where `events.done`.
        reward_terms: the reward by term.
        vehicle: motion at the end of the step, before any respawn.
        goal: (num_agents,) int32 goals during the step, chosen at its start if goals
            are dynamic.
        goal_events: what became of dynamic goals; None while goals are fixed.
    """

    observation: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    events: Events
    metrics: dict[str, jax.Array]
    reward_terms: dict[str, jax.Array]
    vehicle: Motion
    goal: jax.Array
    goal_events: GoalEvents | None = None
