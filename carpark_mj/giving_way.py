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

from collections.abc import Mapping
from typing import get_args

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import ContextName, GivingWayConfig
from carpark_mj.observations.localised import nearest

CONTEXTS: tuple[ContextName, ...] = get_args(ContextName)
Contexts = dict[ContextName, jax.Array]


@struct.dataclass
class GivingWayCounts:
    """Steps of the running episodes, by context; all (num_agents,) float32.

    Attributes:
        met: steps in the context.
        gave_way: those of them in which the agent chose to let go of its goal, for
            another or to explore. Goals that were lost are not let go of.
    """

    met: Contexts
    gave_way: Contexts


def tracked_agents(
    pose_w: jax.Array,
    parked_pose: jax.Array,
    count: int,
    parked_present: jax.Array | None = None,
) -> jax.Array:
    """Who tracks whom: the nearest cars, agents and parked cars alike, by centres.

    Args:
        pose_w: (num_agents, 3).
        parked_pose: (num_parked_cars, 3); none where only agents are tracked.
        count: cars that an agent tracks (n_track).
        parked_present: (num_parked_cars,) bool; None = all.

    Returns:
        (num_agents, num_agents) bool, [i, j] whether agent i tracks agent j.
    """
    num_agents = pose_w.shape[0]
    if count == 0:
        return jnp.zeros((num_agents, num_agents), bool)
    xy = jnp.concatenate([pose_w[:, :2], parked_pose[:, :2]])
    present = jnp.ones(xy.shape[0], bool)
    if parked_present is not None:
        present = present.at[num_agents:].set(parked_present)
    mask = present & ~jnp.eye(num_agents, xy.shape[0], dtype=bool)
    index, found = nearest(pose_w[:, :2], xy, mask, count)
    hit = (index[:, :, None] == jnp.arange(num_agents)) & found[:, :, None]
    return hit.any(axis=1)


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
        tracked: (num_agents, num_agents) bool, see `tracked_agents`.
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
    before: jax.Array,
    after: jax.Array,
    reward: jax.Array,
) -> jax.Array:
    """Replaces the reward of agents that keep a bad goal.

    Args:
        config: the scheme, which names the enforced context.
        contexts: of the step.
        before: (num_agents,) goals at its start.
        after: (num_agents,) goals chosen in it.
        reward: (num_agents,) of the goal transitions as they are paid otherwise.

    Returns:
        (num_agents,) the same, but `bad_goal` where a bad goal was kept.
    """
    if config.context is None:
        return reward
    bad = contexts[config.context] & (after == before)
    return jnp.where(bad, jnp.asarray(config.bad_goal, reward.dtype), reward)


def init_counts(num_agents: int) -> GivingWayCounts:
    """Counts at the start of an episode."""
    zero = jnp.zeros(num_agents, jnp.float32)
    return GivingWayCounts(dict.fromkeys(CONTEXTS, zero), dict.fromkeys(CONTEXTS, zero))


def update_counts(
    counts: GivingWayCounts, contexts: Contexts, before: jax.Array, after: jax.Array
) -> GivingWayCounts:
    """Adds a step; `after` are the goals (num_agents,) that were chosen in it."""
    let_go = after != before
    return GivingWayCounts(
        met={name: counts.met[name] + contexts[name] for name in CONTEXTS},
        gave_way={
            name: counts.gave_way[name] + (contexts[name] & let_go) for name in CONTEXTS
        },
    )


def count_metrics(counts: GivingWayCounts) -> dict[str, jax.Array]:
    """The counts as named metrics, `met_<context>` and `gave_way_<context>`."""
    met = {f"met_{name}": counts.met[name] for name in CONTEXTS}
    return met | {f"gave_way_{name}": counts.gave_way[name] for name in CONTEXTS}


def conformities(totals: Mapping[str, float]) -> dict[str, float]:
    """How often agents gave way in each context, P(goal changed | context).

    Args:
        totals: sums of `count_metrics` over all agents and episodes.

    Returns:
        `conformity_<context>` in [0, 1], NaN for a context that never occurred.
    """
    return {
        f"conformity_{name}": totals[f"gave_way_{name}"] / met
        if (met := totals[f"met_{name}"])
        else float("nan")
        for name in CONTEXTS
    }
