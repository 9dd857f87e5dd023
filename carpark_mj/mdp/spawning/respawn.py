"""New goals and start poses, one agent after the other so that they stay apart."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.goals import Occupancy, evolve, new_goal
from carpark_mj.mdp.spawning.collision_course import ATTEMPTS, crash_pose
from carpark_mj.mdp.spawning.poses import BlockedAt, is_crash, spawn_pose

# For an agent () of an occupancy and whether its car is new (): where it cannot spawn,
# see `spawn_pose`.
Blocked = Callable[[jax.Array, Occupancy, jax.Array], BlockedAt]


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
        xy, agent_key = pose[:, :2], jax.random.fold_in(key, agent)
        room = blocked(agent, occupancy, new)
        drawn = spawn_pose(
            config, layout, goal_pose[agent], xy, placed, agent_key, room
        )
        if config.crash_ratio:  # goals are given here, so only the target is drawn anew

            def attempt(key: jax.Array):
                own, others = goal_pose[agent, :2], goal_pose[:, :2]
                return crash_pose(
                    config, layout, own, xy, others, placed, placed, key, room
                )

            tried, good = jax.vmap(attempt)(_attempt_keys(agent_key))
            crash = is_crash(config, agent_key) & good.any()
            drawn = jnp.where(crash, tried[jnp.argmax(good)], drawn)
        return (pose.at[agent].set(drawn), placed.at[agent].set(True)), None

    nowhere = jnp.zeros((num_agents, 3), jnp.float32)
    nobody = jnp.zeros(num_agents, bool)
    agents = jnp.arange(num_agents)
    (pose, _), _ = jax.lax.scan(place, (nowhere, nobody), agents)
    return pose


def _attempt_keys(key: jax.Array) -> jax.Array:
    """Keys (ATTEMPTS,) of crash spawns, apart from those of `spawn_pose`."""
    return jax.random.split(jax.random.fold_in(key, ATTEMPTS), ATTEMPTS)


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
    num_tracked: int = 0,
) -> tuple[Occupancy, jax.Array]:
    """Goals, parked cars and poses after some agents' episodes have ended.

    An agent that starts on a collision course gets the goal that made it possible.

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
        num_tracked: nearest parked cars that an agent tracks, see `evolve`.

    Returns:
        The occupancy and the poses (num_agents, 3).
    """
    goal_bays, parked_bays = bays
    num_agents = done.shape[0]

    def one(carry: tuple[Occupancy, jax.Array, jax.Array]):
        occupancy, pose, waiting = carry
        agent = jnp.argmax(waiting)
        agent_key = jax.random.fold_in(key, agent)
        # The first two are what two alone would be.
        goal_key, spawn_key, evolve_key, crash_key = jax.random.split(agent_key, 4)
        xy, others = pose[:, :2], jnp.arange(num_agents) != agent
        evolved = evolve(
            layout,
            occupancy,
            agent,
            xy,
            parked[agent],
            parked_bays,
            (evolve_key, num_tracked) if config.evolution == "random" else None,
        )

        def draw_goal(key: jax.Array) -> tuple[Occupancy, BlockedAt]:
            renewed = new_goal(
                layout,
                evolved,
                agent,
                xy,
                config.min_distance,
                key,
                None if goal_bays is None else goal_bays[agent],
                parked_bays,
            )
            found = renewed.goal[agent] != occupancy.goal[agent]
            if goal_bays is not None:
                renewed = jax.tree.map(partial(jnp.where, found), renewed, occupancy)
            return renewed, blocked(agent, renewed, found)

        renewed, room = draw_goal(goal_key)
        goal_pose = layout.bay_pose[renewed.goal]
        start = spawn_pose(
            config, layout, goal_pose[agent], xy, others, spawn_key, room
        )
        if config.crash_ratio:

            def attempt(key: jax.Array):
                goal_key, pose_key = jax.random.split(key)
                renewed, room = draw_goal(goal_key)
                goal_xy = layout.bay_pose[renewed.goal, :2]
                drawn, good = crash_pose(
                    config,
                    layout,
                    goal_xy[agent],
                    xy,
                    goal_xy,
                    others,
                    ~waiting,
                    pose_key,
                    room,
                )
                return (renewed, drawn), good

            tried, good = jax.vmap(attempt)(jax.random.split(crash_key, ATTEMPTS))
            crash = is_crash(config, spawn_key) & good.any()
            renewed, start = jax.tree.map(
                lambda new, old: jnp.where(crash, new[jnp.argmax(good)], old),
                tried,
                (renewed, start),
            )
        return renewed, pose.at[agent].set(start), waiting.at[agent].set(False)

    # A loop over those who are done only: most steps end nobody's episode.
    occupancy, pose, _ = jax.lax.while_loop(
        lambda carry: carry[2].any(), one, (occupancy, pose_w, done)
    )
    return occupancy, pose
