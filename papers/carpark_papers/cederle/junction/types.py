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
    """What the cars of an episode have to do."""

    routes: Routes  # (cars,) the ways
    start: jax.Array  # (cars,) distances along them at which they start [m]
    goal_xy: jax.Array  # (num_agents, 2) goals [m]
    # (cars,) int32 numbers in the scenario of what the cars have to do; None
    # where missions are not dealt out, and cars stand in its order
    order: jax.Array | None


@struct.dataclass
class State:
    """A junction at one instant."""

    cars: Any  # of the back end, any pytree
    motion: Motion  # (cars,) motion of the cars
    along: jax.Array  # (cars,) distances of the cars along their routes [m]
    task: Task  # of the episode
    # (cars,) bool; cars that have left are nobody's obstacle. Agents leave in the
    # step after that in which they finish
    present: jax.Array
    active: jax.Array  # (num_agents,) bool, the agent's episode is running
    unpaid: jax.Array  # (num_agents,) way since the last reward for it [m]
    returns: jax.Array  # (num_agents,) rewards of the episode so far, undiscounted
    # (num_agents, pixels, pixels, frames) uint8, the newest last; None where
    # agents observe vectors
    frames: jax.Array | None
    step: jax.Array  # () int32 control steps made
    key: jax.Array  # randomness


@struct.dataclass
class Events:
    """What happened to agents (num_agents,) in a step, bool; False of inactive ones."""

    off_road: jax.Array  # the centre is off the asphalt
    on_shoulder: jax.Array  # a corner is
    wrong_way: jax.Array  # points more than 90 degrees off its route's direction
    crashed: jax.Array  # its box overlapped another car's
    off_route: jax.Array  # the centre has left the lanes of its route
    arrived: jax.Array  # within reach of its goal
    timed_out: jax.Array  # the episode's steps are used up
    diverged: jax.Array  # the physics gave a non-finite number; the car was put back

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
    """What agents (num_agents, ...) get from a step."""

    # of the next episode where one has begun; zeros of agents that had finished
    # before the step
    observation: jax.Array
    reward: jax.Array  # (num_agents,)
    terminated: jax.Array  # (num_agents,) bool; also of agents that had finished before
    # (num_agents,) bool, out of time or diverged: bootstrap from
    # `final_observation`
    truncated: jax.Array
    events: Events  # what happened
    motion: Motion  # (cars,) at the end of the step, before any new episode
    returns: jax.Array  # (num_agents,) undiscounted returns up to this step
    over: jax.Array  # () bool, the episode has ended for everybody
    final_observation: jax.Array  # at the end of the step, before any new episode
