"""Starts on a collision course, on a path out of the goal's bay, and askew in it.

- *Collision course* (Tanner 2022, fixed goals): if both drive straight to their goals,
  the agent meets another one after equal distances.
- *Reverse*: on a path of a few arcs of a kinematic bicycle that leads out of the
  agent's goal bay and touches nothing that stands still. Driven back it ends in the
  bay, so every such episode can be solved.
- *Misaligned*: in the goal bay, over its lines by centimetres or askew. From there a
  car has to manoeuvre on the spot, which it otherwise rarely has to. In bays that ask
  for one end, half stand the wrong way round.

The numbers of a start are uniform in [0, 1), see `starts.draw_uniform`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_inside, norm, rotate, to_world, wrap_angle
from carpark_mj.layouts.types import BayEnd, Layout
from carpark_mj.spawning.config import SpawnConfig
from carpark_mj.spawning.placing import Placing, SpawnInputs, Surroundings
from carpark_mj.spawning.starts import Draws, Shapes, draw_heading, on_grid, pick
from carpark_mj.types import Vehicle

ATTEMPTS = 10  # at a collision course: new goal, new other agent; then at random
MEETINGS = 11  # points where the two would meet, per attempt

PATHS = 8  # out of a bay per start, of which the longest counts
ARCS = 3
LONGEST = 10.0  # m of path
SPACING = 0.25  # m between the points of a path, each tested
POINTS = round(LONGEST / SPACING) + 1
MARGIN = 0.05  # m kept to walls, discs and parked cars
# From the middle of the bay to the start [m]: farther than the rules `tanner` (0.8 m)
# and `precise` (0.2 m) allow; what `strict` allows, a box within the lines, is tested.
NEAREST = 1.0
# Gap to other agents' footprints [m]: from 3 m/s, the highest speed of the presets,
# they brake to a stop within 1.7 m, a control step of reaction included.
ROOM = 2.0

POSES = 16  # in the goal bay per start, of which one that is free is taken
FARTHEST = (0.5, 0.4, 0.15)  # along the bay and across [m], and askew [rad]


class Targets(NamedTuple):
    """Agents that another can be set on a collision course with."""

    xy: jax.Array  # (num_agents, 2) centres [m]
    goal_xy: jax.Array  # (num_agents, 2) centres of their goals [m]
    mask: jax.Array  # (num_agents,) bool, those that drive to a goal


def course_shapes(num_agents: int) -> Shapes:
    """The numbers of one attempt at a collision course."""
    return {
        "target": (num_agents,),  # which agent
        "meeting": (MEETINGS,),  # where the two would meet
        "course_heading": (MEETINGS,),  # see `draw_heading`
    }


def course_pose(
    config: SpawnConfig,
    layout: Layout,
    around: Surroundings,
    goal_xy: jax.Array,
    targets: Targets,
    draws: Draws,
) -> tuple[jax.Array, jax.Array]:
    """One attempt to start an agent, whose goal is at (2,), on a collision course.

    The target is uniform among the agents that are `conflict_distance` or more from
    their goals. The two would meet at a point of the target's straight path, uniform
    between `conflict_distance` before its goal and `min_distance` ahead of it. The
    start lies behind that point, seen from the own goal, as far as the target is from
    it. The first of `MEETINGS` points counts whose start lies in a spawn region, keeps
    `min_distance` to every other agent and touches nothing. The heading is random.

    Returns:
        (3,) pose of the footprint's centre, and () bool whether the attempt succeeded.
    """
    distances = norm(targets.xy - targets.goal_xy)
    able = targets.mask & (distances >= config.conflict_distance)
    target = pick(able, draws["target"])
    distance, end = distances[target], targets.goal_xy[target]
    longest = distance - config.min_distance
    found = able.any() & (longest >= config.conflict_distance)

    shortest = config.conflict_distance
    rest = shortest + draws["meeting"] * (longest - shortest)
    meeting = end + rest[:, None] * _unit(targets.xy[target] - end)
    start = meeting - (distance - rest)[:, None] * _unit(goal_xy - meeting)

    # In the spawn region that holds it, on its grid if there is one.
    spawn_pose, size = layout.spawn_pose, layout.spawn_size
    local = rotate(start[:, None] - spawn_pose[:, :2], -spawn_pose[:, 2])
    inside = jnp.all(jnp.abs(local) <= size / 2, axis=-1) & layout.spawn_mask
    region = jnp.argmax(inside, axis=-1)
    local = jnp.take_along_axis(local, region[:, None, None], axis=1)[:, 0]
    local = on_grid(config, local, size[region])
    start = spawn_pose[region, :2] + rotate(local, spawn_pose[region, 2])
    yaw = draw_heading(layout, region, draws["course_heading"])
    pose = jnp.concatenate([start, yaw[:, None]], axis=-1)
    good = inside.any(axis=-1) & (around.distance(start) > config.min_distance)
    good = good & ~around.touches(pose)
    return pose[jnp.argmax(good)], found & good.any()


def _unit(vector: jax.Array) -> jax.Array:
    return vector / jnp.maximum(norm(vector)[..., None], 1e-6)


# The numbers of a reverse start.
REVERSE_SHAPES: Shapes = {
    "nose_out": (PATHS,),  # which way round the car stands in the bay
    "share": (PATHS, ARCS),  # of the arcs in a path
    "curvature": (PATHS, ARCS),  # of the arcs, up to the car's sharpest on either side
    "direction": (PATHS, ARCS),  # whether it is driven forwards
    "path_point": (POINTS,),  # which point of the path
}


def reverse_pose(
    inputs: SpawnInputs,
    placing: Placing,
    around: Surroundings,
    agent: jax.Array,
    draws: Draws,
) -> tuple[jax.Array, jax.Array]:
    """Draws a start on a path out of the goal's bay for one agent ().

    Every path ends before it touches anything, and the longest is taken. The start is
    uniform among those of its points that no rule calls parked and that leave `ROOM` to
    the other agents.

    Returns:
        (3,) pose of the footprint's centre, and () bool whether there is one.
    """
    assert inputs.cars is not None
    layout, goal = inputs.layout, placing.goal[agent]
    bay_pose, bay_size = layout.bay_pose[goal], layout.bay_size[goal]
    size = inputs.cars.size[agent]
    nose_out = clamp_to_bay_end(layout, goal, draws["nose_out"])
    paths = paths_out(inputs.cars, agent, bay_pose, draws | {"nose_out": nose_out})

    blocked = around.blocks(paths.reshape(-1, 3), size + 2 * MARGIN)
    outside = jnp.abs(paths[..., :2]) > layout.extent  # not every lot has walls around
    stop = blocked.reshape(paths.shape[:2]) | outside[..., 0] | outside[..., 1]
    count = jnp.where(stop.any(axis=1), jnp.argmax(stop, axis=1), POINTS)
    longest = jnp.argmax(count)
    path = paths[longest]

    clear = jnp.arange(POINTS) < count[longest]
    out = norm(path[:, :2] - bay_pose[:2]) >= NEAREST
    out = out & ~box_inside(path, size, bay_pose, bay_size)
    alone = around.room(path) > ROOM
    # Without a bay for the new car the old one is kept, whose size may be another.
    good = clear & out & alone & placing.found[agent]
    return path[pick(good, draws["path_point"])], good.any()


def clamp_to_bay_end(layout: Layout, bay: jax.Array, nose_out: jax.Array) -> jax.Array:
    """Clamps orientations (n,), below 0.5 nose in, to those that a bay () allows."""
    if layout.bay_end is None:
        return nose_out
    end = layout.bay_end[bay]
    nose_out = jnp.where(end == BayEnd.NOSE_FIRST, 0.0, nose_out)
    return jnp.where(end == BayEnd.TAIL_FIRST, 1.0, nose_out)


def paths_out(
    cars: Vehicle, agent: jax.Array, bay_pose: jax.Array, draws: Draws
) -> jax.Array:
    """Paths (n, POINTS, 3) out of a bay of one agent's car, points `SPACING` apart.

    The rear axle of a kinematic bicycle moves on arcs whose chords are known, so all
    points are computed at once. Poses are of the footprint's centre.
    """
    ahead = cars.centre_offset[agent]  # of the rear axle
    sharpest = jnp.tan(cars.max_steering[agent]) / cars.wheelbase[agent]
    curvature = (2.0 * draws["curvature"] - 1.0) * sharpest
    direction = jnp.where(draws["direction"] < 0.5, -1.0, 1.0)
    share = 1.0 - draws["share"]  # in (0, 1]
    arcs = LONGEST * share / sum(share[:, k : k + 1] for k in range(ARCS))

    turned = jnp.where(draws["nose_out"] < 0.5, jnp.pi, 0.0)
    yaw = (bay_pose[2] + turned)[:, None]
    x = bay_pose[0] - ahead * jnp.cos(yaw)
    y = bay_pose[1] - ahead * jnp.sin(yaw)
    rest = SPACING * jnp.arange(POINTS)
    for k in range(ARCS):
        arc = arcs[:, k, None]
        driven = direction[:, k, None] * jnp.clip(rest, 0.0, arc)
        turn = curvature[:, k, None] * driven
        chord = driven * jnp.sinc(turn / (2.0 * jnp.pi))
        x = x + chord * jnp.cos(yaw + turn / 2.0)
        y = y + chord * jnp.sin(yaw + turn / 2.0)
        yaw, rest = yaw + turn, rest - arc
    x, y = x + ahead * jnp.cos(yaw), y + ahead * jnp.sin(yaw)
    return jnp.stack([x, y, wrap_angle(yaw)], axis=-1)


# The numbers of a misaligned start.
MISALIGNED_SHAPES: Shapes = {
    "off": (POSES, 3),  # offset from the middle, along the bay and across, and heading
    "way_round": (POSES,),  # of the car
    "score": (POSES,),  # of the free poses the largest wins
}


def misaligned_pose(
    inputs: SpawnInputs,
    placing: Placing,
    around: Surroundings,
    agent: jax.Array,
    draws: Draws,
) -> tuple[jax.Array, jax.Array]:
    """Draws a start in one agent's goal bay, over its lines or the wrong way round.

    It overlaps no other agent, but may be right beside one. Arguments and results are
    those of `reverse_pose`.
    """
    assert inputs.cars is not None
    layout, goal = inputs.layout, placing.goal[agent]
    bay_pose, bay_size = layout.bay_pose[goal], layout.bay_size[goal]
    size = inputs.cars.size[agent]
    off = (2.0 * draws["off"] - 1.0) * jnp.asarray(FARTHEST)
    nose_in = draws["way_round"] < 0.5
    wrong = nose_in != (clamp_to_bay_end(layout, goal, draws["way_round"]) < 0.5)
    pose = to_world(bay_pose, off.at[:, 2].add(jnp.where(nose_in, jnp.pi, 0.0)))
    parked = box_inside(pose, size, bay_pose, bay_size) & ~wrong
    good = ~around.blocks(pose, size + 2 * MARGIN) & around.free(pose)
    good = good & ~parked & placing.found[agent]
    return pose[pick(good, draws["score"])], good.any()
