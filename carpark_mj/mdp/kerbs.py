"""Kerbs and wheel stops: low obstacles that wheels may touch slowly.

The body passes over them. The rectangle about the tyres does not, as wide as a kerb's
height allows them to come. A car that touches one slowly is stopped dead before it; a
car that touches one faster has crashed into a wall.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import move_forward, norm
from carpark_mj.geometry.obstacles import Boxes
from carpark_mj.layouts.types import Layout, WallKind
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.types import Motion, State

HEIGHT = 0.1  # m, of kerbs and wheel stops
STOP_DEPTH = 0.15  # m
STOP_INSET = 0.3  # m, from the lines on either side of its bay
TYRE_WIDTH = 0.2  # m [est]
PARALLEL = 2.4  # length over width of a bay from which it is parallel to its lane


def low_obstacles(config: EpisodeConfig, layout: Layout) -> Boxes:
    """Kerbs of a lot, and the wheel stops of its bays that are not parallel ones."""
    kerb = layout.wall_mask & (layout.wall_kind == WallKind.KERB)
    kerbs = layout.wall_pose, layout.wall_size, kerb
    if not config.wheel_stops:
        return Boxes(*kerbs[:2], mask=kerb, kind=ObstacleKind.WALL)
    length, width = layout.bay_size[..., 0], layout.bay_size[..., 1]
    to_centre = length / 2 - config.wheel_stops + STOP_DEPTH / 2
    stops = (
        move_forward(layout.bay_pose, -to_centre),
        jnp.stack([jnp.full_like(width, STOP_DEPTH), width - 2 * STOP_INSET], -1),
        layout.bay_mask & (length < PARALLEL * width),
    )
    pose, size, mask = map(jnp.concatenate, zip(kerbs, stops, strict=True))
    return Boxes(pose, size, mask=mask, kind=ObstacleKind.WALL)


def wheel_boxes(state: State, pose_w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rectangles about the tyres at the height of a kerb.

    Args:
        state: has the cars (num_agents,).
        pose_w: (num_agents, ..., 3) poses of their footprints' centres.

    Returns:
        Poses (num_agents, ..., 3) and sizes (num_agents, 2).
    """
    car = state.physics.vehicle
    # A wheel of radius r touches an edge at height h this far ahead of its hub.
    reach = jnp.sqrt(2 * car.wheel_radius * HEIGHT - HEIGHT**2)
    ahead = car.wheelbase / 2 - car.centre_offset
    ahead = jnp.expand_dims(ahead, range(1, pose_w.ndim - 1))
    size = jnp.stack([car.wheelbase + 2 * reach, car.track_width + TYRE_WIDTH], -1)
    return move_forward(pose_w, ahead), size


def touches(config: EpisodeConfig, state: State, trace_w: jax.Array) -> jax.Array:
    """(num_agents, k) bool, whose wheels touch a kerb at poses (num_agents, k, 3)."""
    obstacles = low_obstacles(config, state.layout)
    pose, size = wheel_boxes(state, trace_w)
    overlap = obstacles.overlap(pose[:, :, None], size[:, None, None])
    return (overlap & obstacles.counts(len(trace_w))[:, None]).any(-1)


def stops(
    config: EnvConfig, state: State, motion: Motion
) -> tuple[jax.Array, jax.Array]:
    """Cars that a kerb stops in a step, and how.

    Args:
        config: the environment.
        state: at the start of the step.
        motion: of its cars at the end, as if there were no kerbs.

    Returns:
        (num_agents,) bool, those that touch one slowly, and their traces
        (num_agents, k, 3), which end at the last instant before they touch.
    """
    trace_w = motion.trace_w
    count = trace_w.shape[1]
    touched = touches(config.episode, state, trace_w)
    first = jnp.argmax(touched, axis=1)[:, None]
    earlier = jnp.concatenate([state.motion.pose_w[:, None], trace_w[:, :-1]], axis=1)
    speed = norm((trace_w - earlier)[..., :2]) * (count / config.sim.ctrl_dt)
    slow = jnp.take_along_axis(speed, first, 1)[:, 0] <= config.episode.kerb_speed
    held = jnp.take_along_axis(earlier, first[..., None], axis=1)
    after = (jnp.arange(count) >= first)[..., None]
    return touched.any(axis=1) & slow, jnp.where(after, held, trace_w)


def find_hits_and_kerbs(config: EpisodeConfig, state: State) -> dict[str, jax.Array]:
    """`find_hits` with kerbs that only wheels touch; those stopped do not any more."""
    kerb = state.layout.wall_kind == WallKind.KERB
    walls = dataclasses.replace(state.layout, wall_mask=state.layout.wall_mask & ~kerb)
    hits = find_hits(dataclasses.replace(state, layout=walls), config.hitbox_scale)
    touched = touches(config, state, state.motion.trace_w).any(axis=1)
    name = ObstacleKind.WALL.label
    return hits | {name: hits[name] | touched}
