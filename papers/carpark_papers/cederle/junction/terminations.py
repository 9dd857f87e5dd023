"""What ends an episode, and other events.

Collisions are overlaps of the cars' boxes at the traced instants of the step. What
counts as off road, on the shoulder, off route and wrong way follows SMARTS: the first
two go by the car's centre and corners, the third by the lanes of its route.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_corners, boxes_overlap, norm
from carpark_papers.cederle.junction.roads import LANE_WIDTH, on_road
from carpark_papers.cederle.junction.routes import heading_at, project
from carpark_papers.cederle.junction.types import Events, State

GOAL_RADIUS = 2.0  # m, SMARTS's


def detect_events(state: State, max_steps: int) -> Events:
    """The events of a step, all False for agents that are not active.

    Args:
        state: at its end, agents not yet removed.
        max_steps: control steps of an episode.
    """
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
