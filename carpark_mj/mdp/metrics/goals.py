"""How often goals are chosen, kept, lost and given up; see `giving_way`."""

from typing import get_args

import jax

from carpark_mj.config import ContextName
from carpark_mj.mdp.progress import is_nearer
from carpark_mj.types import NO_BAY, GoalEvents, Transition

CONTEXTS: tuple[ContextName, ...] = get_args(ContextName)
CHANGES = ("stop_explore", "change_goal", "stop_goal", "lost_untracked", "lost_taken")
COUNTS = (
    "explored_steps",
    "towards_bay_steps",
    *CHANGES,
    *(f"met_{name}" for name in CONTEXTS),
    *(f"gave_way_{name}" for name in CONTEXTS),
)


def count_goals(events: GoalEvents, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `COUNTS`.

    `met_<context>` is 1 in the context, `gave_way_<context>` if the agent also chose
    another goal or to explore; losing a goal does not count as giving way.
    """
    gave_up = events.change_goal | events.stop_goal
    counts = {
        "explored_steps": events.exploring,
        "towards_bay_steps": events.exploring & is_nearer_to_any(transition),
        **{name: getattr(events, name) for name in CHANGES},
    }
    met = {f"met_{name}": events.contexts[name] for name in CONTEXTS}
    gave_way = {
        f"gave_way_{name}": events.contexts[name] & gave_up for name in CONTEXTS
    }
    return counts | met | gave_way


def is_nearer_to_any(transition: Transition) -> jax.Array:
    """Whether the step led agents (num_agents,) nearer to a bay tracked at its start.

    Raises:
        ValueError: goals are fixed, so that no bays are tracked.
    """
    before, after = transition.before, transition.after
    if before.tracked_bays is None:
        raise ValueError("agents track bays only where they choose their goals")
    bay_xy = before.layout.bay_pose[before.tracked_bays, :2]
    nearer = is_nearer(before.motion.xy[:, None], after.motion.xy[:, None], bay_xy)
    return (nearer & (before.tracked_bays != NO_BAY)).any(axis=1)
