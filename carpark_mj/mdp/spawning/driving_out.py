"""Goals that follow from where a car starts: cars in bays drive out, others drive in.

MetaDrive's multi-agent parking lot (Li et al. 2021); see `GoalConfig.drive_out`.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import point_box_distance
from carpark_mj.layouts.types import BayKind, Layout
from carpark_mj.mdp.bays import marked
from carpark_mj.mdp.spawning.draws import pick
from carpark_mj.mdp.spawning.placing import Placing
from carpark_mj.types import NO_BAY


def goal_of_start(
    layout: Layout, placing: Placing, agent: jax.Array, scores: jax.Array
) -> jax.Array:
    """Draws the goal () int32 of an agent whose start pose has been drawn.

    Uniform over the exits if it starts in a bay, any number of agents to each;
    otherwise over the bays that no other agent drives to; agents that are about to
    leave may stand in them. Over the exits, too, if there is no such bay.

    Args:
        layout: with exits.
        placing: all agents, this one at its start.
        agent: () int32 index.
        scores: (bays,) uniform numbers in [0, 1).
    """
    is_exit = layout.bay_kind == BayKind.EXIT
    gap = point_box_distance(placing.xy[agent], layout.bay_pose, layout.bay_size)
    leaves = ((gap <= 0) & layout.bay_mask & ~is_exit).any()
    drives = ~placing.waiting & (jnp.arange(placing.goal.shape[0]) != agent)
    taken = marked(layout, jnp.where(drives, placing.goal, NO_BAY))
    free = layout.bay_mask & ~is_exit & ~taken
    leaves = leaves | ~free.any()
    return pick(jnp.where(leaves, layout.bay_mask & is_exit, free), scores)
