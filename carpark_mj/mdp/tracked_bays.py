"""The free bays that each agent tracks, in slots that keep their bays.

A bay is free if it holds no parked car: bays that are other agents' goals, or that
someone is driving through, count as well (Tanner 2022). An agent tracks the nearest. A
bay stays in its slot for as long as it is among them, as in his text, not his program:
"my second bay" means the same from step to step, whichever of the two is nearer.
"""

import jax
import jax.numpy as jnp

from carpark_mj.layouts.types import Layout
from carpark_mj.observations.localised import nearest


def free_bays(layout: Layout, taken: jax.Array) -> jax.Array:
    """(bays,) bool, the bays of a lot without those `taken` (k,) by cars.

    The number of bays stands for none, see `goals.Occupancy`.
    """
    return layout.bay_mask.at[taken].set(False)


def no_spaces(num_agents: int, num_spaces: int, num_bays: int) -> jax.Array:
    """What agents (num_agents, num_spaces) track before they have looked round."""
    return jnp.full((num_agents, num_spaces), num_bays, jnp.int32)


def track_spaces(
    layout: Layout, xy: jax.Array, free: jax.Array, tracked: jax.Array
) -> jax.Array:
    """Looks round for the nearest free bays.

    Bays that are still among them keep their slots. The others leave, and newcomers
    fill the empty slots from the first on, the nearest first.

    Args:
        layout: the lot.
        xy: (num_agents, 2) centres of the agents [m].
        free: (bays,) or (num_agents, bays) bool, what counts.
        tracked: (num_agents, num_spaces) int32 the bays tracked so far, the number of
            bays in empty slots.

    Returns:
        (num_agents, num_spaces) int32, as `tracked`.
    """
    num_agents, num_spaces = tracked.shape
    free = jnp.broadcast_to(free, (num_agents, layout.num_bays))
    bay, present = nearest(xy, layout.bay_pose[:, :2], free, num_spaces)
    bay, present = bay[:, None, :], present[:, None, :]  # (agents, slots, ranks)
    same = (tracked[:, :, None] == bay) & present
    empty = ~same.any(axis=2, keepdims=True)
    newcomer = present & ~same.any(axis=1, keepdims=True)
    # The k-th newcomer enters the k-th empty slot.
    turn = jnp.cumsum(empty, axis=1) == jnp.cumsum(newcomer, axis=2)
    here = same | (turn & empty & newcomer)
    return jnp.min(jnp.where(here, bay, layout.num_bays), axis=2).astype(jnp.int32)


def nearer_to_any(
    layout: Layout, spaces: jax.Array, before_xy: jax.Array, after_xy: jax.Array
) -> jax.Array:
    """Whether a step led nearer to any of the bays tracked at its start.

    Args:
        layout: the lot.
        spaces: (num_agents, num_spaces) int32 bays tracked.
        before_xy: (num_agents, 2) centres at the start of the step [m].
        after_xy: (num_agents, 2) at its end.

    Returns:
        (num_agents,) bool.
    """
    bay_xy = layout.bay_pose[spaces, :2]
    before = jnp.linalg.norm(bay_xy - before_xy[:, None], axis=-1)
    after = jnp.linalg.norm(bay_xy - after_xy[:, None], axis=-1)
    return ((after < before) & (spaces < layout.num_bays)).any(axis=1)
