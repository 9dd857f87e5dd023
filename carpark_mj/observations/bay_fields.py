"""The bays that agents track and choose goals from, and the agents near them.

Lists of bays hold `NO_BAY` where there is none.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import (
    FAR,
    FARTHEST,
    LENGTH,
    POSE_FIELDS,
    Field,
    far,
    localise,
    repeated,
    repeated_values,
)
from carpark_mj.observations.parts import Part, Sight
from carpark_mj.types import NO_BAY, Motion

_BAY_FIELDS = (
    Field(
        "present",
        1,
        0.0,
        1.0,
        "padding mask: 1 if the bay exists, else all its numbers are 0",
        is_mask=True,
    ),
    *POSE_FIELDS,
    Field(
        "size", 2, 0.0, 2.0, f"length and width less own [{LENGTH:g} m]", metres=LENGTH
    ),
    Field("distance", 1, 0.0, FARTHEST, f"to its centre [{FAR:g} m]", metres=FAR),
)
_RIVAL_FIELDS = (
    Field(
        "nearest_agent",
        1,
        0.0,
        FARTHEST,
        f"from it to the nearest of all agents [{FAR:g} m]",
        metres=FAR,
    ),
    Field(
        "claim",
        2,
        0.0,
        FARTHEST,
        f"1 and that of the nearest with this goal [{FAR:g} m]; 0",
        metres=FAR,
    ),
)


def choice_part(num_tracked_bays: int) -> Part:
    """Which of the tracked bays an agent has chosen."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        bays = sight.tracked_bays
        choice = goal_code(sight.goal[:, None], bays)[:, 0]
        return {"goal_choice": jax.nn.one_hot(choice, num_tracked_bays + 1)}

    meaning = "one-hot: exploring, or which tracked bay is the goal"
    size = num_tracked_bays + 1
    field = Field("goal_choice", size, 0.0, 1.0, meaning, reveals_goal=True)
    return Part((field,), fill)


def bays_part(count: int, global_information: bool) -> Part:
    """The tracked bays, with who is near them if there is global information."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        layout, motion, bays = sight.layout, sight.motion, sight.tracked_bays
        values = _localise_bays(layout, motion, bays)
        if global_information:
            values |= _rival_values(sight, bays)
        return repeated_values("bay", values)

    fields = [*_BAY_FIELDS, *(_RIVAL_FIELDS if global_information else ())]
    return Part(tuple(repeated("bay", count, fields)), fill)


def _localise_bays(
    layout: Layout, motion: Motion, bays: jax.Array
) -> dict[str, jax.Array]:
    """`_BAY_FIELDS` (num_agents, count, k) of bays; zeros for `NO_BAY`."""
    room = layout.bay_size[bays] - motion.size[:, None]
    values = localise(motion.pose_w, layout.parked_pose[bays], room, bays != NO_BAY)
    distance = jnp.minimum(norm(values["position"]), FARTHEST)[..., None]
    return values | {"distance": distance}


def goal_code(goal: jax.Array, bays: jax.Array) -> jax.Array:
    """Goals as numbers that observers know.

    Args:
        goal: (num_agents, count) bays; `NO_BAY` = exploring.
        bays: (num_agents, num_tracked_bays) the observers track.

    Returns:
        (num_agents, count) int: 0 exploring, 1 to num_tracked_bays which of the
        observer's bays, num_tracked_bays + 1 a bay the observer does not track.
    """
    match = bays[:, None] == goal[..., None]
    code = jnp.where(match.any(-1), 1 + jnp.argmax(match, -1), 1 + bays.shape[1])
    return jnp.where(goal == NO_BAY, 0, code)


def rivals(
    layout: Layout, agent_xy: jax.Array, goal: jax.Array, bays: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """How near agents are to bays: global information (Tanner 2022, eq. 3.7).

    Args:
        layout: the lot.
        agent_xy: (num_agents, 2) centres [m].
        goal: (num_agents,) bays.
        bays: (num_agents, count) asked for.

    Returns:
        (num_agents, count) distances [m] to the bays' centres, of the nearest agent and
        of the nearest that has the bay as goal, inf if none has. The observer counts
        too.
    """
    gap = layout.bay_pose[bays][..., None, :2] - agent_xy
    gap = norm(gap)
    wants = bays[..., None] == goal
    return jnp.min(gap, axis=-1), jnp.min(jnp.where(wants, gap, jnp.inf), axis=-1)


def _rival_values(sight: Sight, bays: jax.Array) -> dict[str, jax.Array]:
    """`_RIVAL_FIELDS` (num_observers, count, k) of bays (num_observers, count).

    Zeros where there is no bay or claim.
    """
    nearest, claim = rivals(sight.layout, sight.agents.xy, sight.state.goal, bays)
    present, claimed = bays != NO_BAY, jnp.isfinite(claim)
    claimed = claimed & present
    claim = far(jnp.where(claimed, claim, 0.0))
    return {
        "nearest_agent": far(jnp.where(present, nearest, 0.0)[..., None]),
        "claim": jnp.stack([claimed.astype(claim.dtype), claim], axis=-1),
    }


def _goal_rivals(sight: Sight) -> dict[str, jax.Array]:
    found = _rival_values(sight, sight.goal[:, None])
    return {f"goal_{name}": value[:, 0] for name, value in found.items()}


# The agents near a fixed goal.
RIVALS = Part(
    tuple(
        dataclasses.replace(field, name=f"goal_{field.name}", reveals_goal=True)
        for field in _RIVAL_FIELDS
    ),
    _goal_rivals,
)
