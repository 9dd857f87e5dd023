"""The bays that agents track and choose their goals from, and who else wants them."""

import jax
import jax.numpy as jnp

from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import FAR
from carpark_mj.observations.localised import localise
from carpark_mj.types import Motion


def tracked_bays(
    layout: Layout, vehicle: Motion, spaces: jax.Array
) -> dict[str, jax.Array]:
    """Describes tracked bays in the observers' frames.

    Args:
        layout: the lot.
        vehicle: the agents (num_agents,).
        spaces: (num_agents, num_spaces) bays; `layout.num_bays` where there is none,
            which gives zeros.

    Returns:
        Fields (num_agents, num_spaces, k), named as in `fields`.
    """
    present = spaces < layout.num_bays
    room = layout.bay_size[spaces] - vehicle.size[:, None]
    values = localise(vehicle.pose_w, layout.bay_pose[spaces], room, present)
    distance = jnp.linalg.norm(values["position"], axis=-1, keepdims=True)
    return values | {"distance": distance}


def goal_code(goal: jax.Array, spaces: jax.Array, num_bays: int) -> jax.Array:
    """What observers may know of goals: a number each.

    Args:
        goal: (num_agents, count) bays; `num_bays` = exploring.
        spaces: (num_agents, num_spaces) bays the observers track, `num_bays` = none.
        num_bays: of the layout.

    Returns:
        (num_agents, count) int: 0 exploring, 1 to num_spaces which of the observer's
        bays, num_spaces + 1 a bay the observer does not track.
    """
    match = spaces[:, None] == goal[..., None]
    code = jnp.where(match.any(-1), 1 + jnp.argmax(match, -1), 1 + spaces.shape[1])
    return jnp.where(goal == num_bays, 0, code)


def rivals(
    layout: Layout, agent_xy: jax.Array, goal: jax.Array, bays: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """How near agents are to bays: global information (Tanner 2022, eq. 3.7).

    Args:
        layout: the lot.
        agent_xy: (num_agents, 2) centres [m].
        goal: (num_agents,) bays.
        bays: (num_agents, k) asked for.

    Returns:
        (num_agents, k) distances [m] to the bays' centres, of the nearest agent and of
        the nearest that has the bay as goal, inf if none has. The observer counts too.
    """
    gap = layout.bay_pose[bays][..., None, :2] - agent_xy
    gap = jnp.linalg.norm(gap, axis=-1)
    wants = bays[..., None] == goal
    return jnp.min(gap, axis=-1), jnp.min(jnp.where(wants, gap, jnp.inf), axis=-1)


def rival_fields(
    layout: Layout, agent_xy: jax.Array, goal: jax.Array, bays: jax.Array
) -> dict[str, jax.Array]:
    """The same as fields (num_agents, k, ...), zeros where there is no bay or claim."""
    nearest, claim = rivals(layout, agent_xy, goal, bays)
    present, claimed = bays < layout.num_bays, jnp.isfinite(claim)
    claimed = claimed & present
    claim = jnp.where(claimed, claim, 0.0) / FAR
    return {
        "nearest_agent": jnp.where(present, nearest, 0.0)[..., None] / FAR,
        "claim": jnp.stack([claimed.astype(claim.dtype), claim], axis=-1),
    }
