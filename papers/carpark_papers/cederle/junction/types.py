"""State of a junction and the results of a step. All are pytrees.

Cars are the agents' first, then the human-driven ones. Frames and units are those of
`carpark_mj.types`.
"""

from typing import Any

import jax
from flax import struct

from carpark_mj.types import Motion
from carpark_papers.cederle.junction.roads import Routes


@struct.dataclass
class Task:
    """What the cars of an episode have to do.

    Attributes:
        routes: (cars,) the ways.
        start: (cars,) distances along them at which they start [m].
        goal_xy: (num_agents, 2) goals [m].
        order: (cars,) int32 numbers in the scenario of what the cars have to do; None
            where missions are not dealt out, and cars stand in its order.
    """

    routes: Routes
    start: jax.Array
    goal_xy: jax.Array
    order: jax.Array | None


@struct.dataclass
class State:
    """A junction at one instant.

    Attributes:
        cars: of the back end, any pytree.
        motion: (cars,) motion of the cars.
        along: (cars,) distances of the cars along their routes [m].
        task: of the episode.
        present: (cars,) bool; cars that have left are nobody's obstacle. Agents leave
            in the step after that in which they finish.
        active: (num_agents,) bool, the agent's episode is running.
        unpaid: (num_agents,) way since the last reward for it [m].
        returns: (num_agents,) rewards of the episode so far, undiscounted.
        frames: (num_agents, pixels, pixels, frames) uint8, the newest last; None where
            agents observe vectors.
        step: () int32 control steps made.
        key: randomness.
    """

    cars: Any
    motion: Motion
    along: jax.Array
    task: Task
    present: jax.Array
    active: jax.Array
    unpaid: jax.Array
    returns: jax.Array
    frames: jax.Array | None
    step: jax.Array
    key: jax.Array


@struct.dataclass
class Events:
    """What happened to agents (num_agents,) in a step, bool; False of inactive ones.

    Attributes:
        off_road: the centre is off the asphalt.
        on_shoulder: a corner is.
        wrong_way: points more than 90 degrees off its route's direction.
        crashed: its box overlapped another car's.
        off_route: the centre has left the lanes of its route.
        arrived: within reach of its goal.
        timed_out: the episode's steps are used up.
        diverged: the physics gave a non-finite number; the car was put back.
    """

    off_road: jax.Array
    on_shoulder: jax.Array
    wrong_way: jax.Array
    crashed: jax.Array
    off_route: jax.Array
    arrived: jax.Array
    timed_out: jax.Array
    diverged: jax.Array

    @property
    def success(self) -> jax.Array:
        """(num_agents,) the agent has done what it should: arrived."""
        return self.arrived

    @property
    def terminal(self) -> jax.Array:
        """(num_agents,) ends the agent's episode by itself, as in SMARTS."""
        return self.off_road | self.crashed | self.off_route | self.arrived


@struct.dataclass
class TimeStep:
    """What agents (num_agents, ...) get from a step.

    Attributes:
        observation: of the next episode where one has begun; zeros of agents that had
            finished before the step.
        reward: (num_agents,).
        terminated: (num_agents,) bool; also of agents that had finished before.
        truncated: (num_agents,) bool, out of time or diverged: bootstrap from
            `final_observation`.
        events: what happened.
        motion: (cars,) at the end of the step, before any new episode.
        returns: (num_agents,) undiscounted returns up to this step.
        over: () bool, the episode has ended for everybody.
        final_observation: at the end of the step, before any new episode.
    """

    observation: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    events: Events
    motion: Motion
    returns: jax.Array
    over: jax.Array
    final_observation: jax.Array
