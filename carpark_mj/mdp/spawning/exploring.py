"""Starts of agents that choose their goals: random, close to a bay or in conflict.

From the reference implementation of Tanner 2022, not from its text. Start pose and
first goal are two steps, because the bays that an agent tracks follow from where it
stands.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.bays import marked
from carpark_mj.mdp.spawning.draws import draw_uniform, pick
from carpark_mj.mdp.spawning.placing import Placing, SpawnInputs, Surroundings
from carpark_mj.mdp.spawning.poses import (
    at_random_after,
    close_points,
    draw_heading,
    draw_kind,
    random_pose,
    redraw,
    spawn_shapes,
    split_redraws,
    walk_numbers,
)
from carpark_mj.types import NO_BAY

TAKES_CLOSE_BAY = 0.5  # probability that a close start has the bay for its goal


class ExploringDraws(NamedTuple):
    """Uniform numbers in [0, 1) for one start of an exploring agent.

    Attributes:
        start: for a random start.
        walk: (bays, k) for a point close to every bay, see `close_points`.
        heading: (bays,) see `draw_heading`.
        order: (bays,) which bay.
    """

    start: Any
    walk: Any
    heading: Any
    order: Any


def _shapes(config: SpawnConfig, layout: Layout) -> ExploringDraws:
    bays = layout.num_bays if config.close_ratio else 0
    walk = (bays, walk_numbers(config))
    return ExploringDraws(spawn_shapes(config), walk, (bays,), (bays,))


def place_exploring(
    config: SpawnConfig,
    inputs: SpawnInputs,
    placing: Placing,
    around: Surroundings,
    key: jax.Array,
) -> Placing:
    """Draws where an agent starts to explore.

    A close start draws one point, see `close_points`, for every free bay that is no
    agent's goal, and picks a random one of those that keep `min_distance` to every
    other agent and touch nothing. Without any, and for all other starts, it is random.

    Args:
        config: spawning rules.
        inputs: the lot.
        placing: all agents, this one exploring.
        around: obstacles to keep away from, and the agent's index.
        key: consumed.
    """
    layout = inputs.layout
    key, again = split_redraws(config, key)
    draws = draw_uniform(_shapes(config, layout), key)
    start = at_random_after(placing.tries[around.agent], draws.start)
    kind = draw_kind(config, start.kind)
    pose = random_pose(config, layout, around, start)
    pose = redraw(config, layout, around, pose, again)
    bay = jnp.full((), NO_BAY, jnp.int32)
    if config.close_ratio:
        others_goal = jnp.where(around.others, placing.goal, NO_BAY)
        taken = jnp.concatenate([placing.parked_bay, others_goal])
        free = layout.bay_mask & ~marked(layout, taken)

        def beside(bay_pose: jax.Array, walk: jax.Array):
            xy, region = close_points(config, layout, bay_pose[:2], walk[None])
            return xy[0], region

        xy, region = jax.vmap(beside)(layout.bay_pose, draws.walk)
        yaw = draw_heading(layout, region, draws.heading)
        poses = jnp.concatenate([xy, yaw[:, None]], axis=-1)
        good = free & (around.distance(xy) > config.min_distance)
        good = good & ~around.touches(poses)
        close = kind.close & good.any()
        drawn = pick(good, draws.order)
        pose = jnp.where(close, poses[drawn], pose)
        bay = jnp.where(close, drawn, bay)
    return placing.set(around.agent, pose_w=pose, close_bay=bay, conflict=kind.conflict)


def first_goals(
    placing: Placing,
    tracked_bays: jax.Array,
    goal: jax.Array,
    begun: jax.Array,
    key: jax.Array,
) -> jax.Array:
    """The agents' goals (num_agents,) int32 once those that begin have their first.

    After a close start it is the bay next to it with a probability of one half, if the
    agent tracks it; in conflict a random one of the tracked bays that are another
    agent's goal, goals of close starts included. All others explore.

    Args:
        placing: how they were placed.
        tracked_bays: (num_agents, num_tracked_bays) int32 from there.
        goal: (num_agents,) int32 before; `NO_BAY` of those that begin.
        begun: (num_agents,) bool, who begins.
        key: consumed.
    """
    num_agents, num_slots = tracked_bays.shape
    draws = jax.random.uniform(key, (num_agents, 1 + num_slots))
    real, close_bay = tracked_bays != NO_BAY, placing.close_bay
    takes = begun & (draws[:, 0] < TAKES_CLOSE_BAY)
    takes = takes & (real & (tracked_bays == close_bay[:, None])).any(axis=1)
    goal = jnp.where(takes, close_bay, jnp.where(begun, NO_BAY, goal))

    def share(tracked: jax.Array, real: jax.Array, scores: jax.Array) -> jax.Array:
        wanted = real & (tracked[:, None] == goal).any(axis=1)
        return jnp.where(wanted.any(), tracked[pick(wanted, scores)], NO_BAY)

    shared = jax.vmap(share)(tracked_bays, real, draws[:, 1:])
    conflict = begun & placing.conflict & ~takes
    return jnp.where(conflict, shared, goal).astype(jnp.int32)
