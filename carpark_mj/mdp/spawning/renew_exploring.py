"""Episodes that begin without a goal: parked cars and start poses, agent by agent."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.chosen_goals import lose_goals, taken_by_others
from carpark_mj.mdp.goals import Occupancy, evolve
from carpark_mj.mdp.spawning.exploring import ExploringStart, exploring_start
from carpark_mj.mdp.spawning.respawn import Blocked


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
    num_tracked: int = 0,
) -> tuple[Occupancy, ExploringStart, jax.Array]:
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
        num_tracked: nearest parked cars that an agent tracks, see `goals.evolve`.

    Returns:
        The occupancy, the starts (num_agents,), whose poses are everybody's and the
        rest that of the new ones, and (num_agents,) bool, whose goal, though the own
        episode goes on, is taken by another.
    """
    num_agents = done.shape[0]
    agents, new = jnp.arange(num_agents), jnp.ones((), bool)
    taken = taken_by_others(occupancy.goal, parked) & ~done

    def one(carry: tuple[Occupancy, ExploringStart, jax.Array]):
        occupancy, starts, waiting = carry
        agent = jnp.argmax(waiting)
        spawn_key, evolve_key = jax.random.split(jax.random.fold_in(key, agent))
        xy = starts.pose[:, :2]
        occupancy = evolve(
            layout,
            occupancy,
            agent,
            xy,
            parked[agent],
            parked_bays,
            (evolve_key, num_tracked) if config.evolution == "random" else None,
        )
        goal = occupancy.goal.at[agent].set(layout.num_bays)
        occupancy = dataclasses.replace(occupancy, goal=goal)
        start = exploring_start(
            config,
            layout,
            occupancy.goal,
            occupancy.parked_bay,
            xy,
            agents != agent,
            spawn_key,
            blocked(agent, occupancy, new),
        )
        starts = jax.tree.map(lambda all, own: all.at[agent].set(own), starts, start)
        return occupancy, starts, waiting.at[agent].set(False)

    starts = ExploringStart(
        pose=pose_w,
        close_bay=jnp.full(num_agents, layout.num_bays, jnp.int32),
        crash=jnp.zeros(num_agents, bool),
    )
    # A loop over those who are done only: most steps end nobody's episode.
    occupancy, starts, _ = jax.lax.while_loop(
        lambda carry: carry[2].any(), one, (occupancy, starts, done)
    )
    goal, _ = lose_goals(occupancy.goal, taken, layout.num_bays)
    return dataclasses.replace(occupancy, goal=goal), starts, taken
