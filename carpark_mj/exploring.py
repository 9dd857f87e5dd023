"""Episodes that begin without a goal: parked cars and start poses, agent by agent."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.dynamic_goals import lose_goals, taken_by_others
from carpark_mj.goals import Occupancy, evolve
from carpark_mj.layouts.types import Layout
from carpark_mj.respawn import Blocked
from carpark_mj.spawn import spawn_pose


def anywhere(config: SpawnConfig) -> SpawnConfig:
    """The spawning rules of agents that have no goal to start close to."""
    return dataclasses.replace(config, close_ratio=0.0)


def renew_exploring(
    config: SpawnConfig,
    layout: Layout,
    occupancy: Occupancy,
    pose_w: jax.Array,
    done: jax.Array,
    parked: jax.Array,
    key: jax.Array,
    parked_bays: jax.Array | None,
    blocked: Blocked,
) -> tuple[Occupancy, jax.Array, jax.Array]:
    """Goals, parked cars and poses after some agents' episodes have ended.

    One after the other, a parked car moves to where the agent has parked, everybody
    else who has that goal goes exploring, and the agent starts anew, exploring.

    Args:
        config: where to.
        layout: the lot.
        occupancy: before.
        pose_w: (num_agents, 3) before.
        done: (num_agents,) bool, whose episodes have ended.
        parked: (num_agents,) bool, who has parked; no two in one bay.
        key: consumed.
        parked_bays: (num_parked_cars, bays) bool, those a parked car fits in; None =
            all.
        blocked: where cars cannot spawn.

    Returns:
        The occupancy, the poses (num_agents, 3), and (num_agents,) bool, whose goal,
        though the own episode goes on, is taken by another.
    """
    num_agents = done.shape[0]
    agents, new = jnp.arange(num_agents), jnp.ones((), bool)
    taken = taken_by_others(occupancy.goal, parked) & ~done
    roam = anywhere(config)

    def one(carry: tuple[Occupancy, jax.Array, jax.Array]):
        occupancy, pose, waiting = carry
        agent = jnp.argmax(waiting)
        occupancy = evolve(
            layout, occupancy, agent, pose[:, :2], parked[agent], parked_bays
        )
        goal = occupancy.goal.at[agent].set(layout.num_bays)
        occupancy = dataclasses.replace(occupancy, goal=goal)
        start = spawn_pose(
            roam,
            layout,
            jnp.zeros_like(pose[0]),  # no goal
            pose[:, :2],
            agents != agent,
            jax.random.fold_in(key, agent),
            blocked(agent, occupancy, new),
        )
        return occupancy, pose.at[agent].set(start), waiting.at[agent].set(False)

    # A loop over those who are done only: most steps end nobody's episode.
    occupancy, pose, _ = jax.lax.while_loop(
        lambda carry: carry[2].any(), one, (occupancy, pose_w, done)
    )
    goal, _ = lose_goals(occupancy.goal, taken, layout.num_bays)
    return dataclasses.replace(occupancy, goal=goal), pose, taken
