"""Giving way: who holds a goal that another agent is nearer to, and who lets go of it.

An agent with a goal is in a *context* if some other agent is strictly nearer to that
goal (centres, world distance) and besides, in the letters of Tanner 2022:

| context | the nearer agent |
|---|---|
| `local_same` (L,S) | is tracked and has the same goal |
| `local_any` (L,A) | is tracked |
| `global_same` (G,S) | has the same goal |
| `global_any` (G,A) | – |
| `untracked_same` (G+,S) | is not tracked and has the same goal |
| `untracked_any` (G+,A) | is not tracked |
| `untracked_other` (G+,A) | is not tracked and does not have the same goal |
| `only_untracked_same` (G+,S) | as in (G,S), and none is there as in (L,S) |
| `only_untracked_any` (G+,A) | as in (G,A), and none is there as in (L,A) |
| `global_same_not_local_any` | as in (G,S), and none is there as in (L,A) |

The study defines G+ by an intersection that would equal L, and calls it disjoint from
L, which only the set differences `only_untracked_*` are; its published figures come
from `untracked_same` and `untracked_other`. All are counted side by side. The last row
tells whether agents that are punished in (L,A) only give way to ones they cannot see
too, or whether a tracked agent was there as well.

The *situation* of a step is the one that agents observe when they choose: poses and
tracked agents at its start. They choose in turn, in the order of their numbers, as in
the study: each meets the new goals of those before it and the old ones of those after
it (`goals_in_turn`). Cars move together once all have chosen.
"""

from typing import get_args

import jax
import jax.numpy as jnp

from carpark_mj.config import ContextName, GivingWayConfig

CONTEXTS: tuple[ContextName, ...] = get_args(ContextName)
# What is counted: steps in each context, and those in which the agent gave way.
COUNTS = tuple(f"{what}_{name}" for what in ("met", "gave_way") for name in CONTEXTS)
Contexts = dict[ContextName, jax.Array]


def goals_in_turn(before: jax.Array, after: jax.Array) -> jax.Array:
    """The goals that agents meet when they choose, each after those of lower number.

    Args:
        before: (num_agents,) goals at the start of the step.
        after: (num_agents,) goals chosen in it.

    Returns:
        (num_agents, num_agents), [i, j] the goal of agent j when agent i chooses.
    """
    number = jnp.arange(before.shape[0])
    return jnp.where(number < number[:, None], after, before)


def find_contexts(
    pose_w: jax.Array,
    goal: jax.Array,
    met_goal: jax.Array,
    bay_pose: jax.Array,
    tracked: jax.Array,
    active: jax.Array,
) -> Contexts:
    """In which contexts each agent is, see the table above.

    Args:
        pose_w: (num_agents, 3) at the start of the step.
        goal: (num_agents,) own goals at the start of the step; the number of bays
            while exploring, when an agent is in no context.
        met_goal: (num_agents, num_agents) goals of the others, see `goals_in_turn`.
        bay_pose: (num_bays, 3).
        tracked: (num_agents, num_agents) bool, [i, j] whether agent i tracks agent j.
        active: (num_agents,) bool; agents that have finished give no way, and nobody
            gives way to them.

    Returns:
        (num_agents,) bool by context.
    """
    num_agents, num_bays = goal.shape[0], bay_pose.shape[0]
    aim = bay_pose[jnp.minimum(goal, num_bays - 1), :2]
    distance = jnp.linalg.norm(pose_w[:, :2] - aim[:, None], axis=-1)
    better = distance < jnp.diagonal(distance)[:, None]
    # One's own distance is not less than itself, but compilers may round twice.
    better = better & ~jnp.eye(num_agents, dtype=bool) & active & active[:, None]
    better = better & (goal < num_bays)[:, None]
    same = met_goal == goal[:, None]

    def some(condition: jax.Array) -> jax.Array:
        return (better & condition).any(axis=1)

    everyone = jnp.ones_like(better)
    local_same, local_any = some(tracked & same), some(tracked)
    global_same, global_any = some(same), some(everyone)
    return {
        "local_same": local_same,
        "local_any": local_any,
        "global_same": global_same,
        "global_any": global_any,
        "untracked_same": some(~tracked & same),
        "untracked_any": some(~tracked),
        "untracked_other": some(~tracked & ~same),
        "only_untracked_same": global_same & ~local_same,
        "only_untracked_any": global_any & ~local_any,
        "global_same_not_local_any": global_same & ~local_any,
    }


def enforce(
    config: GivingWayConfig,
    contexts: Contexts,
    kept: jax.Array,
    terms: dict[str, jax.Array],
) -> dict[str, jax.Array]:
    """Pays agents that keep a bad goal `bad_goal` instead of `continue_goal`.

    Args:
        config: the scheme, which names the enforced context.
        contexts: of the step.
        kept: (num_agents,) bool, who has a goal and kept it in the step.
        terms: the reward (num_agents,) by term, `goal_rewards.dynamic_terms`.

    Returns:
        The terms with `bad_goal` among them, if a context is enforced.
    """
    if config.context is None:
        return terms
    bad = contexts[config.context] & kept
    return terms | {
        "continue_goal": jnp.where(bad, 0.0, terms["continue_goal"]),
        "bad_goal": jnp.where(bad, config.bad_goal, 0.0).astype(jnp.float32),
    }


def count(contexts: Contexts, let_go: jax.Array) -> dict[str, jax.Array]:
    """A step as numbers to be added up over steps, agents and episodes.

    Args:
        contexts: of the step.
        let_go: (num_agents,) bool, who chose another goal or to explore; goals that
            are lost are not let go of.

    Returns:
        (num_agents,) float32 by the names of `COUNTS`: `met_<context>`, 1 in the
        context, and `gave_way_<context>`, 1 if the goal was let go of besides.
    """
    met = {f"met_{name}": contexts[name] for name in CONTEXTS}
    gave_way = {f"gave_way_{name}": contexts[name] & let_go for name in CONTEXTS}
    return {name: x.astype(jnp.float32) for name, x in (met | gave_way).items()}
