"""Giving way: agents with a goal that another agent is nearer to.

An agent with a goal is in a *context* if some other agent is strictly nearer to that
goal (centres, world distance) and also, in the notation of Tanner 2022:

| context | the nearer agent |
|---|---|
| `local_same` (L,S) | is tracked and has the same goal |
| `local_any` (L,A) | is tracked |
| `global_same` (G,S) | has the same goal |
| `global_any` (G,A) | any |
| `untracked_same` (G+,S) | is not tracked and has the same goal |
| `untracked_any` (G+,A) | is not tracked |
| `untracked_other` (G+,A) | is not tracked and does not have the same goal |
| `only_untracked_same` (G+,S) | as in (G,S), but no agent as in (L,S) |
| `only_untracked_any` (G+,A) | as in (G,A), but no agent as in (L,A) |
| `global_same_not_local_any` | as in (G,S), but no agent as in (L,A) |

The study defines G+ by an intersection that equals L, and calls it disjoint from L.
Only the set differences `only_untracked_*` are disjoint from L; published figures come
from `untracked_same` and `untracked_other`. Metrics count all of them. The last row
measures whether agents that are penalized in (L,A) only also give way to agents that
they do not track.

The *situation* of a step is what agents observe when they choose: poses and tracked
agents at its start. Agents choose in the order of their numbers, as in the study. Each
sees the new goals of agents before it and the old goals of agents after it
(`goals_in_turn`). All cars move after the last choice.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import ContextName
from carpark_mj.geometry import norm
from carpark_mj.types import NO_BAY, State


def goals_in_turn(before: jax.Array, after: jax.Array) -> jax.Array:
    """The goals of all agents as each agent sees them when it chooses.

    Args:
        before: (num_agents,) goals at the start of the step.
        after: (num_agents,) goals chosen in it.

    Returns:
        (num_agents, num_agents), [i, j] the goal of agent j when agent i chooses.
    """
    number = jnp.arange(before.shape[0])
    return jnp.where(number < number[:, None], after, before)


def find_contexts(
    before: State, chosen: jax.Array, tracked: jax.Array
) -> dict[ContextName, jax.Array]:
    """Contexts of each agent, see the table above.

    Agents that have finished are in no context and cause none.

    Args:
        before: at the start of the step, goals not chosen yet.
        chosen: (num_agents,) int32 goals chosen.
        tracked: (num_agents, num_agents) bool, [i, j] whether agent i tracks agent j.

    Returns:
        (num_agents,) bool by context; an agent that was exploring is in none.
    """
    goal, active = before.goal, before.active
    met_goal = goals_in_turn(goal, chosen)
    aim = before.layout.bay_pose[jnp.minimum(goal, before.layout.num_bays - 1), :2]
    distance = norm(before.motion.xy - aim[:, None])
    better = distance < jnp.diagonal(distance)[:, None]
    # The agent's own distance, computed twice, may round differently.
    own = jnp.eye(goal.shape[0], dtype=bool)
    better = better & ~own & active & active[:, None] & (goal != NO_BAY)[:, None]
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
