"""State, actions, termination and rewards at the junction.

Cars are the agents' first, then the human-driven ones. Frames and units follow
`carpark_mj.types`. With one lane per direction there is no lane to change to: actions
are target speeds, and the two lane changes are equal.

Collisions are overlaps of the cars' boxes at the traced instants of the step. What
counts as off road, on the shoulder, off route and wrong way follows SMARTS: the first
two go by the car's centre and corners, the third by the lanes of its route.

A metre of progress earns 1, paid once more than 0.5 m have added up since the last
payment. Leaving the road or the route, driving on the shoulder or the wrong way, or a
crash costs 10 (once in a step), the goal earns 10.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import box_corners, boxes_overlap, norm
from carpark_mj.mdp.actions import ActionSpec, sanitize_indices, sanitize_numbers
from carpark_mj.types import Motion
from carpark_papers.cederle.junction.config import RewardRules
from carpark_papers.cederle.junction.roads import (
    LANE_WIDTH,
    Routes,
    heading_at,
    on_road,
    project,
)


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


ACTIONS = ("keep_lane", "slow_down", "change_lane_left", "change_lane_right")
TARGET_SPEEDS = (15.0, 0.0, 12.5, 12.5)  # m/s
KEEP_LANE, SLOW_DOWN = 0, 1
INDEX, SCALAR = ActionSpec(0, (len(ACTIONS),)), ActionSpec(1)
# Where scalars pass from one action to the next: the study's MADDPG.
EDGES = (-0.5, 0.0, 0.5)


def parse(spec: ActionSpec, action: jax.Array) -> jax.Array:
    """Indices (n,) int32 of the actions (n,) or (n, 1) that agents ask for.

    What is NaN or out of range is sanitized as everywhere.
    """
    action = action.reshape(-1, 1)
    if spec == INDEX:
        return sanitize_indices(action, spec.choices)[0][:, 0]
    numbers = sanitize_numbers(action)[0]
    return (numbers >= jnp.array(EDGES)).sum(axis=-1, dtype=jnp.int32)


def target_speeds(action: jax.Array) -> jax.Array:
    """Target speeds (...) [m/s] of actions (...) int."""
    return jnp.array(TARGET_SPEEDS)[action]


GOAL_RADIUS = 2.0  # m, SMARTS's


def detect_events(state: State, max_steps: int) -> Events:
    """The events of a step from the state at its end; False of agents not active."""
    n, motion, task = state.active.shape[0], state.motion, state.task
    own: jax.Array = motion.pose_w[:n]
    corners = box_corners(own, motion.size[:n])
    routes = jax.tree.map(lambda x: x[:n], task.routes)
    span = motion.size[:n, 0] / 2
    heading = heading_at(routes, state.along[:n], span)
    off = project(routes, own[:, :2])[1]
    terminal = {
        "off_road": ~on_road(own[:, :2]),
        "on_shoulder": ~on_road(corners).all(axis=-1),
        "wrong_way": jnp.cos(own[:, 2] - heading) < 0.0,
        "crashed": collide(state)[:n],
        "off_route": jnp.abs(off) > LANE_WIDTH / 2,
        "arrived": norm(own[:, :2] - task.goal_xy) <= GOAL_RADIUS,
    }
    events = {name: flag & state.active for name, flag in terminal.items()}
    diverged = state.active & ~motion.finite[:n]
    late = state.active & (state.step >= max_steps) & ~diverged
    events = Events(**events, timed_out=late, diverged=diverged)
    return dataclasses.replace(events, timed_out=late & ~events.terminal)


def collide(state: State) -> jax.Array:
    """Which cars (cars,) overlapped another one in the last step."""
    trace, size = state.motion.trace_w, state.motion.size
    hit = boxes_overlap(
        trace[:, None], size[:, None, None], trace[None], size[None, :, None]
    ).any(axis=-1)
    met = state.present[:, None] & state.present
    return (hit & met & ~jnp.eye(len(size), dtype=bool)).any(axis=1)


LEAST_PROGRESS = 0.5  # m
EVENT = 10.0


def pay_progress(unpaid: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rewards for progress (num_agents,) [m] since the last ones, and the rest."""
    due = unpaid > LEAST_PROGRESS
    return jnp.where(due, unpaid, 0.0), jnp.where(due, 0.0, unpaid)


def reward(rules: RewardRules, progress: jax.Array, events: Events) -> jax.Array:
    """Rewards (num_agents,) of a step, given the rewards for progress."""
    failed = events.off_road | events.on_shoulder | events.wrong_way
    failed = failed | events.crashed | events.off_route
    cost = jnp.where(failed, -EVENT, 0.0)
    gain = jnp.where(events.arrived, EVENT, 0.0)
    if rules.events == "added":
        earned = progress + cost + gain
    else:  # the goal comes last of the events
        earned = jnp.where(failed, cost, jnp.where(events.arrived, gain, progress))
    if rules.joint:
        earned = jnp.broadcast_to(earned.sum(), earned.shape)
    return earned
