"""Starts on course for a collision with another agent (Tanner 2022, fixed goals).

Driving straight to their goals, both would meet after equal distances.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.geometry import norm, rotate
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.spawning.draws import pick
from carpark_mj.mdp.spawning.placing import Surroundings
from carpark_mj.mdp.spawning.poses import draw_heading, on_grid

ATTEMPTS = 10  # new goal, new other agent; then the start is random
DRAWS = 11  # points where the two would meet, per attempt


class Targets(NamedTuple):
    """Agents that another can be set on a collision course with.

    Attributes:
        xy: (num_agents, 2) centres [m].
        goal_xy: (num_agents, 2) centres of their goals [m].
        mask: (num_agents,) bool, those that drive to a goal.
    """

    xy: jax.Array
    goal_xy: jax.Array
    mask: jax.Array


class CourseDraws(NamedTuple):
    """Uniform numbers in [0, 1) for one attempt; with a leading axis for several.

    Attributes:
        target: (num_agents,) which agent.
        meeting: (DRAWS,) where the two would meet.
        heading: (DRAWS,) see `draw_heading`.
    """

    target: Any
    meeting: Any
    heading: Any


def course_shapes(config: SpawnConfig, num_agents: int) -> CourseDraws:
    """Shapes of the numbers of all attempts, for `draw_uniform`."""
    n = ATTEMPTS if config.conflict_ratio else 0
    return CourseDraws((n, num_agents), (n, DRAWS), (n, DRAWS))


def course_pose(
    config: SpawnConfig,
    layout: Layout,
    around: Surroundings,
    goal_xy: jax.Array,
    targets: Targets,
    draws: CourseDraws,
) -> tuple[jax.Array, jax.Array]:
    """One attempt to start an agent on a collision course.

    The target is uniform among the agents that are `conflict_distance` or more from
    their goals. The two would meet at a point of the target's straight path, uniform
    between `conflict_distance` before its goal and `min_distance` ahead of it. The
    start lies behind that point, seen from the own goal, as far as the target is from
    it. The first of `DRAWS` points counts whose start lies in a spawn region, keeps
    `min_distance` to every other agent and touches nothing. The heading is random.

    Args:
        config: spawning rules.
        layout: the lot.
        around: obstacles to keep away from.
        goal_xy: (2,) centre of the agent's goal [m].
        targets: agents to collide with.
        draws: random numbers.

    Returns:
        (3,) pose of the footprint's centre, and () bool whether the attempt succeeded;
        otherwise the pose is invalid.
    """
    distances = norm(targets.xy - targets.goal_xy)
    able = targets.mask & (distances >= config.conflict_distance)
    target = pick(able, draws.target)
    distance, end = distances[target], targets.goal_xy[target]
    longest = distance - config.min_distance
    found = able.any() & (longest >= config.conflict_distance)

    rest = config.conflict_distance + draws.meeting * (
        longest - config.conflict_distance
    )
    meeting = end + rest[:, None] * _unit(targets.xy[target] - end)
    start = meeting - (distance - rest)[:, None] * _unit(goal_xy - meeting)

    start, region, inside = _into_region(config, layout, start)
    yaw = draw_heading(layout, region, draws.heading)
    pose = jnp.concatenate([start, yaw[:, None]], axis=-1)
    good = inside & (around.distance(start) > config.min_distance)
    good = good & ~around.touches(pose)
    return pose[jnp.argmax(good)], found & good.any()


def _unit(vector: jax.Array) -> jax.Array:
    length = norm(vector)[..., None]
    return vector / jnp.maximum(length, 1e-6)


def _into_region(
    config: SpawnConfig, layout: Layout, xy: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Points (n, 2) on the grid if there is one, their spawn regions, and if in any."""
    pose, size = layout.spawn_pose, layout.spawn_size
    local = rotate(xy[:, None] - pose[:, :2], -pose[:, 2])
    inside = jnp.all(jnp.abs(local) <= size / 2, axis=-1) & layout.spawn_mask
    region = jnp.argmax(inside, axis=-1)
    local = jnp.take_along_axis(local, region[:, None, None], axis=1)[:, 0]
    local = on_grid(config, local, size[region])
    point = pose[region, :2] + rotate(local, pose[region, 2])
    return point, region, inside.any(axis=-1)
