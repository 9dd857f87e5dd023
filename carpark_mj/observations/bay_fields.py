"""The bays that agents track and choose their goals from, and who else heads for them.

Lists of bays hold `NO_BAY` where there is none.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import FAR, FARTHEST, LENGTH, Field, far
from carpark_mj.observations.localised import POSE_FIELDS, localise
from carpark_mj.types import NO_BAY, Motion

BAY_FIELDS = (
    Field(
        "present",
        1,
        0.0,
        1.0,
        "1 if there is such a bay; else all its numbers are 0",
        is_mask=True,
    ),
    *POSE_FIELDS,
    Field(
        "size", 2, 0.0, 2.0, f"length and width less own [{LENGTH:g} m]", metres=LENGTH
    ),
    Field("distance", 1, 0.0, FARTHEST, f"to its centre [{FAR:g} m]", metres=FAR),
)
RIVAL_FIELDS = (
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


def localise_bays(
    layout: Layout, motion: Motion, bays: jax.Array
) -> dict[str, jax.Array]:
    """Describes tracked bays in the observers' frames.

    Args:
        layout: the lot.
        motion: the agents (num_agents,).
        bays: (num_agents, count) int32; `NO_BAY` gives zeros.

    Returns:
        `BAY_FIELDS` (num_agents, count, k).
    """
    room = layout.bay_size[bays] - motion.size[:, None]
    values = localise(motion.pose_w, layout.parked_pose[bays], room, bays != NO_BAY)
    distance = jnp.minimum(norm(values["position"]), FARTHEST)[..., None]
    return values | {"distance": distance}


def goal_code(goal: jax.Array, bays: jax.Array) -> jax.Array:
    """What observers may know of goals: a number each.

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


def rival_values(
    layout: Layout, agent_xy: jax.Array, goal: jax.Array, bays: jax.Array
) -> dict[str, jax.Array]:
    """`RIVAL_FIELDS` (num_agents, count, k); zeros where there is no bay or claim.

    The arguments are those of `rivals`.
    """
    nearest, claim = rivals(layout, agent_xy, goal, bays)
    present, claimed = bays != NO_BAY, jnp.isfinite(claim)
    claimed = claimed & present
    claim = far(jnp.where(claimed, claim, 0.0))
    return {
        "nearest_agent": far(jnp.where(present, nearest, 0.0)[..., None]),
        "claim": jnp.stack([claimed.astype(claim.dtype), claim], axis=-1),
    }
