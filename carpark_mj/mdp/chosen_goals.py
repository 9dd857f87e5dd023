"""Goals that agents choose themselves: explore, or head for a bay they track.

An agent whose goal is the number of bays, `layout.num_bays`, is exploring. A step
begins with everybody's choice, made from what was observed last; what an agent can
choose depends on nobody else, so that choosing in turn or at once is the same. It ends
with goals that are lost: because somebody else has parked there, or, once agents have
looked round again, because the bay is no longer among those they track.
"""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.layouts.types import Layout


@struct.dataclass
class GoalEvents:
    """What became of each agent's goal in a step; all (num_agents,) bool.

    Exactly one of the first five, which the agent chose, holds for one that is active.
    The last two exclude each other and come after the choice.

    Attributes:
        continue_explore: had no goal and took none.
        stop_explore: took a goal.
        continue_goal: kept its goal.
        change_goal: took another goal.
        stop_goal: gave its goal up.
        lost_untracked: lost its goal, which is no longer among the tracked bays.
        lost_taken: lost its goal, where somebody else has parked.
    """

    continue_explore: jax.Array
    stop_explore: jax.Array
    continue_goal: jax.Array
    change_goal: jax.Array
    stop_goal: jax.Array
    lost_untracked: jax.Array
    lost_taken: jax.Array

    @property
    def exploring(self) -> jax.Array:
        """(num_agents,) has no goal during the step."""
        return self.continue_explore | self.stop_goal


# Tallies of an episode, by what became of the goal in its steps; see `GoalEvents`.
GOAL_COUNTS = (
    "explored_steps",
    "towards_space_steps",
    "stop_explore",
    "change_goal",
    "stop_goal",
    "lost_untracked",
    "lost_taken",
)


def goal_counts(events: GoalEvents, nearer: jax.Array) -> dict[str, jax.Array]:
    """A step (num_agents,) as numbers to be added up, by the names of `GOAL_COUNTS`.

    `nearer` (num_agents,) bool says whom the step led nearer to a tracked bay.
    """
    exploring = events.exploring
    counts = {"explored_steps": exploring, "towards_space_steps": exploring & nearer}
    counts |= {name: getattr(events, name) for name in GOAL_COUNTS[2:]}
    return {name: count.astype(jnp.float32) for name, count in counts.items()}


def choose_goals(
    goal: jax.Array, spaces: jax.Array, choice: jax.Array, exploring: int
) -> jax.Array:
    """Applies the agents' choices.

    Args:
        goal: (num_agents,) int32 goals so far.
        spaces: (num_agents, num_spaces) int32 the bays they track.
        choice: (num_agents,) int, 0 = explore, k = the bay in slot k - 1; an empty
            slot, and any other number, keeps the goal.
        exploring: the goal of one that has none, the number of bays.

    Returns:
        (num_agents,) int32 goals.
    """
    number = jnp.arange(1, spaces.shape[1] + 1)
    here = (choice[:, None] == number) & (spaces < exploring)
    chosen = jnp.min(jnp.where(here, spaces, exploring), axis=1)
    chosen = jnp.where(here.any(axis=1), chosen, goal)
    return jnp.where(choice == 0, exploring, chosen).astype(jnp.int32)


def lose_goals(
    goal: jax.Array, lost: jax.Array, exploring: int
) -> tuple[jax.Array, jax.Array]:
    """Sends agents exploring that have lost their goals.

    Args:
        goal: (num_agents,) int32.
        lost: (num_agents,) bool; says nothing of agents that are exploring.
        exploring: see `choose_goals`.

    Returns:
        Goals (num_agents,), and (num_agents,) bool, who has lost one.
    """
    lost = lost & (goal < exploring)
    return jnp.where(lost, exploring, goal), lost


def taken_by_others(goal: jax.Array, parked: jax.Array) -> jax.Array:
    """Whose goal is a bay where somebody else has `parked` in this step; bool."""
    same = (goal[:, None] == goal) & ~jnp.eye(goal.shape[0], dtype=bool)
    return (same & parked).any(axis=1) & ~parked


def goal_events(
    before: jax.Array,
    chosen: jax.Array,
    lost_untracked: jax.Array,
    lost_taken: jax.Array,
    active: jax.Array,
    exploring: int,
) -> GoalEvents:
    """Names what became of goals (num_agents,); nothing for finished agents."""
    had, has = active & (before < exploring), active & (chosen < exploring)
    return GoalEvents(
        continue_explore=active & ~had & ~has,
        stop_explore=~had & has,
        continue_goal=had & has & (before == chosen),
        change_goal=had & has & (before != chosen),
        stop_goal=had & ~has,
        lost_untracked=lost_untracked,
        lost_taken=lost_taken,
    )


def aims(
    layout: Layout, goal: jax.Array, spaces: jax.Array, xy: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """What each agent is after: its goal, or the nearest bay it tracks.

    Args:
        layout: the lot.
        goal: (num_agents,) int32.
        spaces: (num_agents, num_spaces) int32.
        xy: (num_agents, 2) centres of the agents [m].

    Returns:
        Poses (num_agents, 3), and (num_agents,) bool, whether there is any such bay.
    """
    rows = jnp.minimum(spaces, layout.num_bays - 1)
    gap = jnp.linalg.norm(layout.bay_pose[rows, :2] - xy[:, None], axis=-1)
    rank = jnp.argmin(jnp.where(spaces < layout.num_bays, gap, jnp.inf), axis=1)
    near = jnp.take_along_axis(spaces, rank[:, None], axis=1)[:, 0]
    bay = jnp.where(goal < layout.num_bays, goal, near)
    return layout.bay_pose[jnp.minimum(bay, layout.num_bays - 1)], bay < layout.num_bays
