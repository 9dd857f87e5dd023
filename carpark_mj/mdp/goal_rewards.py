"""Reward terms that dynamic goals add or change; see `GoalRewards` for the weights."""

import jax
import jax.numpy as jnp

from carpark_mj.config import RewardConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.chosen_goals import GoalEvents, aims
from carpark_mj.mdp.rewards import goal_potential
from carpark_mj.types import Motion

TERMS = (
    "continue_explore",
    "stop_explore",
    "continue_goal",
    "change_goal",
    "stop_goal",
    "lost_goal",
    "taken_goal",
)


def dynamic_progress(
    config: RewardConfig,
    layout: Layout,
    spaces: jax.Array,
    goals: tuple[jax.Array, jax.Array],
    before: Motion,
    after: Motion,
) -> jax.Array:
    """Progress (num_agents,) when goals change: no closed loop pays, nor any switch.

    Progress is that towards the goal chosen in the step. An agent that explores earns
    none, but driving away from the nearest bay it tracks costs as much as coming
    nearer would have paid: otherwise it would come near with a goal, and leave without
    one, for ever. To take a farther goal costs the way thrown away, a nearer one pays
    nothing. So all terms of a loop that ends where and with what it began add up to
    the sum of potential differences, which is 0, less something.

    Args:
        config: weights.
        layout: the lot.
        spaces: (num_agents, num_spaces) bays tracked at the start of the step.
        goals: (num_agents,) at its start, and as chosen in it.
        before: the agents (num_agents,) at its start.
        after: at its end.
    """
    xy = before.pose_w[:, :2]
    old, _ = aims(layout, goals[0], spaces, xy)
    new, any_bay = aims(layout, goals[1], spaces, xy)
    exploring = goals[1] == layout.num_bays
    # Of an explorer's nearest bay at the end: another may have become that.
    end = jnp.where(
        exploring[:, None], aims(layout, goals[1], spaces, after.pose_w[:, :2])[0], new
    )
    start = goal_potential(config, before.pose_w, new)
    moved = goal_potential(config, after.pose_w, end) - start
    moved = jnp.where(exploring, jnp.minimum(moved, 0.0), moved)
    switched = start - goal_potential(config, before.pose_w, old)
    return jnp.where(any_bay, moved + jnp.minimum(switched, 0.0), 0.0)


def dynamic_terms(
    config: RewardConfig,
    terms: dict[str, jax.Array],
    progress: jax.Array,
    goals: GoalEvents,
    diverged: jax.Array,
) -> dict[str, jax.Array]:
    """The reward of one step with dynamic goals, term by term.

    Args:
        config: weights.
        terms: those of `rewards.reward_terms`, towards the goal chosen in the step.
        progress: (num_agents,) see `dynamic_progress`.
        goals: what became of the goals.
        diverged: (num_agents,) bool, whose terms are all 0.

    Returns:
        Named terms (num_agents,), weights and signs applied.
    """
    pay = config.goals
    terms = terms | {
        "progress": progress,
        "approach": jnp.where(goals.exploring, 0.0, terms["approach"]),
        "continue_explore": pay.continue_explore * goals.continue_explore,
        "stop_explore": pay.stop_explore * goals.stop_explore,
        "continue_goal": pay.continue_goal * goals.continue_goal,
        "change_goal": pay.change_goal * goals.change_goal,
        "stop_goal": pay.stop * goals.stop_goal,
        "lost_goal": pay.lost * goals.lost_untracked,
        "taken_goal": pay.taken_goal * goals.lost_taken,
    }
    return {
        name: jnp.where(diverged, 0.0, term).astype(jnp.float32)
        for name, term in terms.items()
    }
