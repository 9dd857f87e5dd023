"""Starts of agents that choose their goals themselves: random, close or in conflict.

Not in the text of Tanner 2022 but in his program. Start and first goal are two steps,
because the bays that an agent tracks follow from where it stands.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SpawnConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.spawning.poses import (
    BlockedAt,
    clearance,
    close_points,
    draw_heading,
    is_close,
    is_crash,
    spawn_pose,
)

TAKES_CLOSE_BAY = 0.5  # probability that a close start has the bay for its goal


@struct.dataclass
class ExploringStart:
    """Where an agent starts, and what that asks of its first goal.

    Attributes:
        pose: (3,) of the footprint's centre.
        close_bay: () int32 free bay next to which it starts; `layout.num_bays` unless
            the start is close.
        crash: () bool, to have the same goal as another agent if it can.
    """

    pose: jax.Array
    close_bay: jax.Array
    crash: jax.Array


def exploring_start(
    config: SpawnConfig,
    layout: Layout,
    goal: jax.Array,
    parked_bay: jax.Array,
    other_xy: jax.Array,
    other_mask: jax.Array,
    key: jax.Array,
    blocked: BlockedAt = None,
) -> ExploringStart:
    """Draws where an agent () starts to explore.

    A close start is one draw, see `close_points`, for every bay that is free and
    nobody's goal; a random one of those counts that keep `min_distance` to every other
    agent and touch nothing. If there is none, and for all others, it is random.

    Args:
        config: spawning rules.
        layout: the lot.
        goal: (num_agents,) int32, `layout.num_bays` who explores.
        parked_bay: (num_parked_cars,) int32, see `goals.Occupancy`.
        other_xy: (num_agents, 2) centres of the agents [m].
        other_mask: (num_agents,) bool, the agents to keep away from; theirs are the
            goals that count.
        key: consumed.
        blocked: see `spawn_pose`.
    """
    num_bays = layout.num_bays
    # The fifth part is that of `is_close` and `is_crash`.
    random_key, close_key, order_key, yaw_key, _ = jax.random.split(key, 5)
    elsewhere = dataclasses.replace(config, close_ratio=0.0, crash_ratio=0.0)
    pose = spawn_pose(
        elsewhere,
        layout,
        layout.bay_pose[0],
        other_xy,
        other_mask,
        random_key,
        blocked,
    )
    bay = jnp.full((), num_bays, jnp.int32)
    if config.close_ratio:
        taken = jnp.concatenate([parked_bay, jnp.where(other_mask, goal, num_bays)])
        free = layout.bay_mask & ~_marked(taken, num_bays)

        def beside(bay_pose: jax.Array, key: jax.Array):
            xy, region = close_points(config, layout, bay_pose[:2], 1, key)
            return xy[0], region

        keys = jax.random.split(close_key, num_bays)
        xy, region = jax.vmap(beside)(layout.bay_pose, keys)
        yaw = draw_heading(layout, region, yaw_key)
        poses = jnp.concatenate([xy, yaw[:, None]], axis=-1)
        good = free & (clearance(xy, other_xy, other_mask) > config.min_distance)
        if blocked is not None:
            good = good & ~blocked(poses)
        close = is_close(config, key) & good.any()
        drawn = pick(good, order_key)
        pose = jnp.where(close, poses[drawn], pose)
        bay = jnp.where(close, drawn, bay)
    return ExploringStart(pose=pose, close_bay=bay, crash=is_crash(config, key))


def first_goal(
    start: ExploringStart,
    spaces: jax.Array,
    other_goal: jax.Array,
    num_bays: int,
    key: jax.Array,
) -> jax.Array:
    """The goal that an agent starts with, () int32; `num_bays` if it explores.

    After a close start it is the bay next to it with a probability of one half, if the
    agent tracks it; in conflict a random one of the tracked bays that are another
    agent's goal.

    Args:
        start: of the agent.
        spaces: (num_spaces,) int32 bays it tracks, `num_bays` where there is none.
        other_goal: (num_agents,) int32 goals of the others; `num_bays` for the agent
            itself and for who explores.
        num_bays: of the layout, padding included.
        key: consumed.
    """
    take_key, pick_key = jax.random.split(key)
    real = spaces < num_bays
    takes = jax.random.bernoulli(take_key, TAKES_CLOSE_BAY)
    takes = takes & (real & (spaces == start.close_bay)).any()
    wanted = real & (spaces[:, None] == other_goal).any(axis=1)
    conflict = spaces[pick(wanted, pick_key)]
    goal = jnp.where(start.crash & wanted.any(), conflict, num_bays)
    return jnp.where(takes, start.close_bay, goal).astype(jnp.int32)


def first_goals(
    starts: ExploringStart,
    spaces: jax.Array,
    goal: jax.Array,
    fresh: jax.Array,
    num_bays: int,
    key: jax.Array,
) -> jax.Array:
    """The agents' goals (num_agents,) int32 once those that start have their first.

    Args:
        starts: of the agents (num_agents,).
        spaces: (num_agents, num_spaces) int32 bays they track from there.
        goal: (num_agents,) int32 before; `num_bays` for who starts or explores.
        fresh: (num_agents,) bool, who starts.
        num_bays: of the layout, padding included.
        key: consumed.
    """
    keys = jax.random.split(key, fresh.shape[0])
    draw = jax.vmap(first_goal, in_axes=(0, 0, None, None, 0))
    return jnp.where(fresh, draw(starts, spaces, goal, num_bays, keys), goal)


def pick(mask: jax.Array, key: jax.Array) -> jax.Array:
    """A random index () int32 among those where a mask (n,) is true, if any is."""
    score = jax.random.uniform(key, mask.shape)
    return jnp.argmax(jnp.where(mask, score, -1.0)).astype(jnp.int32)


def _marked(index: jax.Array, count: int) -> jax.Array:
    """(count,) bool, true at the indices; `count` marks nothing."""
    return jnp.zeros(count, bool).at[index].set(True, mode="drop")
