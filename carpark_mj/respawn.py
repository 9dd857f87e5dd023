"""New goals and start poses, one agent after the other so that they stay apart."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.goals import Occupancy, evolve, new_goal
from carpark_mj.layouts.types import Layout
from carpark_mj.spawn import spawn_pose

# For an agent () of an occupancy and whether its car is new (): where it cannot spawn,
# see `spawn_pose`.
Blocked = Callable[
    [jax.Array, Occupancy, jax.Array], Callable[[jax.Array], jax.Array] | None
]


def first_poses(
    config: SpawnConfig,
    layout: Layout,
    occupancy: Occupancy,
    key: jax.Array,
    blocked: Blocked,
) -> jax.Array:
    """Start poses (num_agents, 3) of a lot in which nobody is yet.

    Args:
        config: where to.
        layout: the lot.
        occupancy: goals and parked cars.
        key: consumed.
        blocked: where cars cannot spawn.
    """
    goal_pose = layout.bay_pose[occupancy.goal]
    num_agents = occupancy.goal.shape[0]
    new = jnp.ones((), bool)

    def place(carry: tuple[jax.Array, jax.Array], agent: jax.Array):
        pose, placed = carry
        drawn = spawn_pose(
            config,
            layout,
            goal_pose[agent],
            pose[:, :2],
            placed,
            jax.random.fold_in(key, agent),
            blocked(agent, occupancy, new),
        )
        return (pose.at[agent].set(drawn), placed.at[agent].set(True)), None

    nowhere = jnp.zeros((num_agents, 3), jnp.float32)
    nobody = jnp.zeros(num_agents, bool)
    agents = jnp.arange(num_agents)
    (pose, _), _ = jax.lax.scan(place, (nowhere, nobody), agents)
    return pose


def renew(
    config: SpawnConfig,
    layout: Layout,
    occupancy: Occupancy,
    pose_w: jax.Array,
    done: jax.Array,
    parked: jax.Array,
    key: jax.Array,
    bays: tuple[jax.Array | None, jax.Array | None],
    blocked: Blocked,
) -> tuple[Occupancy, jax.Array]:
    """Goals, parked cars and poses after some agents' episodes have ended.

    Args:
        config: where to.
        layout: the lot.
        occupancy: before.
        pose_w: (num_agents, 3) before.
        done: (num_agents,) bool, whose episodes have ended.
        parked: (num_agents,) bool, who has parked.
        key: consumed.
        bays: the bays that can be an agent's goal (num_agents, bays), and those that a
            parked car fits in (num_parked_cars, bays); None = all. An agent for whose
            new car there is no bay keeps its goal, and nothing moves.
        blocked: where cars cannot spawn.

    Returns:
        The occupancy and the poses (num_agents, 3).
    """
    goal_bays, parked_bays = bays
    num_agents = done.shape[0]

    def one(carry: tuple[Occupancy, jax.Array, jax.Array]):
        occupancy, pose, waiting = carry
        agent = jnp.argmax(waiting)
        goal_key, spawn_key = jax.random.split(jax.random.fold_in(key, agent))
        evolved = evolve(
            layout, occupancy, agent, pose[:, :2], parked[agent], parked_bays
        )
        renewed = new_goal(
            layout,
            evolved,
            agent,
            pose[:, :2],
            config.min_distance,
            goal_key,
            None if goal_bays is None else goal_bays[agent],
            parked_bays,
        )
        found = renewed.goal[agent] != occupancy.goal[agent]
        if goal_bays is not None:
            renewed = jax.tree.map(partial(jnp.where, found), renewed, occupancy)
        start = spawn_pose(
            config,
            layout,
            layout.bay_pose[renewed.goal[agent]],
            pose[:, :2],
            jnp.arange(num_agents) != agent,
            spawn_key,
            blocked(agent, renewed, found),
        )
        return renewed, pose.at[agent].set(start), waiting.at[agent].set(False)

    # A loop over those who are done only: most steps end nobody's episode.
    occupancy, pose, _ = jax.lax.while_loop(
        lambda carry: carry[2].any(), one, (occupancy, pose_w, done)
    )
    return occupancy, pose
