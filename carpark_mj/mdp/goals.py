"""Goals and parked cars: who heads for which bay, which bay holds a parked car.

Goals here are fixed for an episode; see `dynamic_goals` for those that are not. Bays
hold at most one parked car, goals are distinct,
and no agent's goal holds a parked car once `new_goal` has run for it.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.layouts.types import Layout


@struct.dataclass
class Occupancy:
    """Who is where in the plan.

    Attributes:
        goal: (num_agents,) int32 index of each agent's goal bay; `layout.num_bays`
            for an agent that is exploring.
        parked_bay: (num_parked_cars,) int32 index of each parked car's bay;
            `layout.num_bays` for a car that this lot has not.
    """

    goal: jax.Array
    parked_bay: jax.Array


def init_occupancy(
    layout: Layout, num_agents: int, num_parked_cars: int, key: jax.Array
) -> Occupancy:
    """Distinct random goals, parked cars in distinct random bays among the rest."""
    # A random order of the real bays: padding sorts last.
    order = jnp.argsort(
        jnp.where(layout.bay_mask, jax.random.uniform(key, layout.bay_mask.shape), 2.0)
    ).astype(jnp.int32)
    return Occupancy(
        goal=order[:num_agents],
        parked_bay=order[num_agents : num_agents + num_parked_cars],
    )


def draw_places(
    fits: jax.Array,
    weights: jax.Array,
    free: jax.Array,
    wanted: jax.Array,
    key: jax.Array,
    anywhere: bool,
) -> tuple[jax.Array, jax.Array]:
    """Draws kinds of cars and distinct bays for them, one car after the other.

    A kind is drawn by weight among those that fit into a bay still free, and then one
    of these bays.

    Args:
        fits: (cars, kinds, bays) bool.
        weights: (kinds,) > 0.
        free: (bays,) bool, bays to choose from.
        wanted: (cars,) bool; the others get no bay.
        key: consumed.
        anywhere: whether a car that fits nowhere gets a free bay nevertheless.

    Returns:
        (cars,) int32 kinds and (cars,) int32 bays; the number of bays where none.
    """
    num_bays = free.shape[0]

    def draw(free: jax.Array, car: tuple[jax.Array, jax.Array, jax.Array]):
        fits, wanted, key = car
        kind_key, bay_key = jax.random.split(key)
        possible = (fits & free).any(axis=1)
        logits = jnp.where(possible | ~possible.any(), jnp.log(weights), -jnp.inf)
        kind = jax.random.categorical(kind_key, logits)
        good = free & fits[kind]
        if anywhere:
            good = jnp.where(good.any(), good, free)
        score = jax.random.uniform(bay_key, (num_bays,))
        bay = jnp.argmax(jnp.where(good, score, -1.0))
        bay = jnp.where(wanted & good.any(), bay, num_bays).astype(jnp.int32)
        return free & (jnp.arange(num_bays) != bay), (kind.astype(jnp.int32), bay)

    keys = jax.random.split(key, wanted.shape[0])
    return jax.lax.scan(draw, free, (fits, wanted, keys))[1]


def evolve(
    layout: Layout,
    occupancy: Occupancy,
    agent: jax.Array,
    agent_xy: jax.Array,
    parked: jax.Array,
    parked_fits: jax.Array | None = None,
    random: tuple[jax.Array, int] | None = None,
) -> Occupancy:
    """Moves a parked car into the bay where an agent has just parked.

    The car farthest from all agents moves (Tanner 2022, section 3.2.1), so that no
    agent sees it go; or at random one that no agent tracks, and any if they track them
    all (what his program was meant to do). The number of parked cars stays constant.

    Args:
        layout: the lot.
        occupancy: before the move.
        agent: () int index of the agent.
        agent_xy: (num_agents, 2) centres of the agents [m].
        parked: () bool; nothing moves where False.
        parked_fits: (num_parked_cars, bays) bool, bays a car fits in; of the cars that
            fit into this one the farthest moves. None = all cars fit everywhere.
        random: a key, consumed, and how many of the nearest parked cars an agent
            tracks, for the random rule. None = the farthest car moves.
    """
    if occupancy.parked_bay.shape[0] == 0:
        return occupancy
    car_xy = layout.bay_pose[occupancy.parked_bay, :2]
    gap = jnp.linalg.norm(car_xy[:, None] - agent_xy, axis=-1)
    if random is None:
        score = gap.min(axis=-1)
    else:
        key, num_tracked = random
        gap = jnp.where(occupancy.parked_bay[:, None] < layout.num_bays, gap, jnp.inf)
        rank = jnp.argsort(jnp.argsort(gap, axis=0), axis=0)  # of each car, by agent
        seen = (rank < num_tracked).any(axis=1)
        score = jax.random.uniform(key, seen.shape) + jnp.where(seen, 0.0, 1.0)
    if parked_fits is not None:
        able = parked_fits[:, occupancy.goal[agent]]
        able = able & (occupancy.parked_bay < layout.num_bays)
        score = jnp.where(able, score, -1.0)
        parked = parked & able.any()
    chosen = jnp.argmax(score)
    moved = occupancy.parked_bay.at[chosen].set(occupancy.goal[agent])
    parked_bay = jnp.where(parked, moved, occupancy.parked_bay)
    return dataclasses.replace(occupancy, parked_bay=parked_bay)


def new_goal(
    layout: Layout,
    occupancy: Occupancy,
    agent: jax.Array,
    agent_xy: jax.Array,
    min_distance: float,
    key: jax.Array,
    agent_fits: jax.Array | None = None,
    parked_fits: jax.Array | None = None,
) -> Occupancy:
    """Draws a new goal for one agent (Tanner 2022, fixed goals).

    Uniform over the bays that are no agent's goal, those with a parked car included. A
    parked car there makes way: to the agent's old goal if that is empty and farther
    than `min_distance` from every other agent, otherwise to a random bay like that.
    If there is none, the goal is drawn among the bays without parked cars.

    Args:
        layout: the lot.
        occupancy: before the draw.
        agent: () int index of the agent.
        agent_xy: (num_agents, 2) centres of the agents [m].
        min_distance: [m].
        key: consumed.
        agent_fits: (bays,) bool, the bays that can be the agent's goal; None = all.
        parked_fits: (num_parked_cars, bays) bool, the bays a parked car can make way
            to; None = all.
    """
    goal_key, refuge_key = jax.random.split(key)
    rows = jnp.arange(layout.num_bays)
    old = occupancy.goal[agent]
    is_goal = jnp.zeros(layout.num_bays, bool).at[occupancy.goal].set(True)
    has_car = jnp.zeros(layout.num_bays, bool).at[occupancy.parked_bay].set(True)
    other = jnp.arange(agent_xy.shape[0]) != agent
    gap = jnp.linalg.norm(layout.bay_pose[:, None, :2] - agent_xy, axis=-1)
    gap = jnp.where(other, gap, jnp.inf).min(axis=-1)

    candidate = layout.bay_mask & ~is_goal
    others_goal = (is_goal & (rows != old)) | ~layout.bay_mask
    refuge = ~others_goal & ~has_car & (gap > min_distance)
    # A refuge must not be the new goal itself, which has a car, so it never is.
    can_move = refuge.any()
    if parked_fits is not None:
        able = (parked_fits & refuge).any(axis=1)
        can_move = jnp.zeros(layout.num_bays, bool).at[occupancy.parked_bay].set(able)
    candidate = candidate & (can_move | ~has_car)
    if agent_fits is not None:
        candidate = candidate & agent_fits
    # With no bay to choose (every other bay taken) the agent keeps its goal.
    candidate = candidate | ((rows == old) & ~candidate.any())
    score = jax.random.uniform(goal_key, (layout.num_bays,))
    goal = jnp.argmax(jnp.where(candidate, score, -1.0)).astype(jnp.int32)
    score = jax.random.uniform(refuge_key, (layout.num_bays,))
    score = jnp.where(rows == old, 2.0, score)
    evicted = occupancy.parked_bay == goal
    if parked_fits is not None:
        refuge = refuge & (parked_fits & evicted[:, None]).any(axis=0)
    shelter = jnp.argmax(jnp.where(refuge, score, -1.0)).astype(jnp.int32)
    return Occupancy(
        goal=occupancy.goal.at[agent].set(goal),
        parked_bay=jnp.where(evicted, shelter, occupancy.parked_bay),
    )
