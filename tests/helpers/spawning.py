"""What a start pose keeps away from, by hand, and whom it would meet."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from helpers.states import parked_at

from carpark_mj.config import EnvConfig
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.spawning.goals import place_agent
from carpark_mj.spawning.placing import (
    SpawnInputs,
    Surroundings,
    start_placing,
    surroundings,
)
from carpark_mj.spawning.special_starts import MISALIGNED_SHAPES, misaligned_pose
from carpark_mj.spawning.starts import draw_uniform
from carpark_mj.vehicle import COMPACT, make_vehicle


def many(draw, count, seed=0):
    """What a function draws with each of many keys, as NumPy arrays."""
    keys = jax.random.split(jax.random.key(seed), count)
    return jax.device_get(jax.jit(jax.vmap(draw))(keys))


def placing_one(inputs, goal, pose=(0.0,) * 3):
    """The first of some agents about to be placed, () or (num_agents,) of goals."""
    goal = jnp.atleast_1d(jnp.asarray(goal, jnp.int32))
    pose = jnp.broadcast_to(jnp.asarray(pose, jnp.float32), (*goal.shape, 3))
    waiting = jnp.arange(goal.shape[0]) == 0
    return start_placing(goal, inputs.parked_cars.bay, pose, waiting)


def begun(layout, spawn, agents=((0.0,) * 3,), count=1500):
    """Poses (count, 3) of agent 0, whose goal is bay 0, in a lot that begins."""
    config, car = EnvConfig(spawn=spawn), make_vehicle(COMPACT)
    cars = jax.tree.map(lambda x: jnp.stack([x] * len(agents)), car)
    inputs = SpawnInputs(layout, parked_at(), cars=cars, first=True)
    placing = placing_one(inputs, range(len(agents)), agents)

    def one(key):
        return place_agent(config, inputs, placing, jnp.array(0), key).pose_w[0]

    return many(one, count, 3)


def misaligned(inputs, placing, count, seed=0):
    """Attempts (count,) to start agent 0 askew in its bay, and which succeeded."""
    around = surroundings(inputs, placing, jnp.array(0))

    def one(key):
        draws = draw_uniform(MISALIGNED_SHAPES, key)
        return misaligned_pose(inputs, placing, around, jnp.array(0), draws)

    return many(one, count, seed)


def surroundings_of(layout, xy=((0.0, 0.0),), others=False, size=None, outlines=None):
    """Agents at xy (num_agents, 2), to keep away from where `others`; nobody parked.

    All head east; `outlines` (num_agents, 2) of their cars, the first of which starts.
    """
    xy = jnp.asarray(xy, jnp.float32)
    return Surroundings(
        pose_w=jnp.pad(xy, ((0, 0), (0, 1))),
        outlines=outlines if outlines is None else jnp.asarray(outlines, jnp.float32),
        agent=jnp.int32(0),
        others=jnp.broadcast_to(jnp.asarray(others), xy.shape[:1]),
        size=size if size is None else jnp.asarray(size, jnp.float32),
        obstacles=lot_obstacles(layout, None, parked_at()),
    )


def walled(layout, centre, size):
    """The layout with a wall instead of its first one."""
    return dataclasses.replace(
        layout,
        wall_pose=layout.wall_pose.at[0].set(jnp.asarray(centre, jnp.float32)),
        wall_size=layout.wall_size.at[0].set(jnp.asarray(size, jnp.float32)),
        wall_mask=layout.wall_mask.at[0].set(True),
    )


def meetings(start, goal, other, other_goal):
    """Ways (...) driven when two agents (..., 2) are nearest, and how near that is."""

    def ahead(a, b):
        return (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)

    gap = start - other
    speed = ahead(start, goal) - ahead(other, other_goal)
    way = -np.sum(gap * speed, axis=-1) / np.sum(speed * speed, axis=-1)
    return way, np.linalg.norm(gap + way[..., None] * speed, axis=-1)


def meets(config, pose, xy, goal, tolerance=2e-3):
    """(n, agents - 1) bool: agent 0 at poses (n, 3) would meet them by the rule.

    Where the agents are, and their goals, is (agents, 2) or (n, agents, 2).
    """
    others, ends = xy[..., 1:, :], goal[..., 1:, :]
    way, near = meetings(pose[:, None, :2], goal[..., :1, :], others, ends)
    whole = np.linalg.norm(others - ends, axis=-1)
    slack = 5 * tolerance
    allowed = way > config.min_distance - slack
    allowed &= way < whole - config.conflict_distance + slack
    return (near < tolerance) & allowed
