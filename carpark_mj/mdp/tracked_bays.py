"""The free bays that each agent tracks, and their slots.

A bay is free if it holds no parked car, even if it is another agent's goal or an agent
is in it (Tanner 2022). An agent tracks the nearest free bays. A bay keeps its slot for
as long as it is tracked, as in the study's text, so that the index of a choice means
the same bay from step to step. With `GoalConfig.slots_by_distance` the bays are sorted
by distance at every step, as in the study's program.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.geometry import nearest, norm
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.bays import free_bays
from carpark_mj.types import NO_BAY, State


def update_tracked_bays(
    state: State, usable: jax.Array | None, by_distance: bool = False
) -> State:
    """Agents track the free bays nearest to them.

    Agents that have finished occupy their goals.

    Args:
        state: of a lot with dynamic goals.
        usable: (num_agents, bays) bool, bays that an agent can track; None = all.
        by_distance: `GoalConfig.slots_by_distance`.
    """
    assert state.tracked_bays is not None
    standing = jnp.where(state.active, NO_BAY, state.goal)
    taken = jnp.concatenate([state.parked_cars.bay, standing])
    free = free_bays(state.layout, taken)
    if usable is not None:
        free = free & usable
    before = state.tracked_bays
    if by_distance:  # all slots are empty, and the nearest enters the first
        before = jnp.full_like(before, NO_BAY)
    tracked_bays = track_bays(state.layout, state.motion.xy, free, before)
    return dataclasses.replace(state, tracked_bays=tracked_bays)


def track_bays(
    layout: Layout, xy: jax.Array, free: jax.Array, tracked_bays: jax.Array
) -> jax.Array:
    """Finds the nearest free bays.

    Bays that are still among them keep their slots. New bays take the slots that become
    empty, the nearest bay the first slot.

    Args:
        layout: the lot.
        xy: (num_agents, 2) centres of the agents [m].
        free: (bays,) or (num_agents, bays) bool, the free bays.
        tracked_bays: (num_agents, num_tracked_bays) int32 so far, `NO_BAY` in empty
            slots.

    Returns:
        (num_agents, num_tracked_bays) int32, as `tracked_bays`.
    """
    num_agents, num_slots = tracked_bays.shape
    free = jnp.broadcast_to(free, (num_agents, layout.num_bays))
    bay, present = nearest(xy, layout.bay_pose[:, :2], free, num_slots)
    bay, present = bay[:, None, :], present[:, None, :]  # (agents, slots, ranks)
    same = (tracked_bays[:, :, None] == bay) & present
    empty = ~same.any(axis=2, keepdims=True)
    newcomer = present & ~same.any(axis=1, keepdims=True)
    # The k-th newcomer enters the k-th empty slot.
    turn = jnp.cumsum(empty, axis=1) == jnp.cumsum(newcomer, axis=2)
    here = same | (turn & empty & newcomer)
    return jnp.min(jnp.where(here, bay, NO_BAY), axis=2).astype(jnp.int32)


def target_bay(
    layout: Layout, goal: jax.Array, tracked_bays: jax.Array, xy: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Each agent's goal or, while it explores, the nearest bay it tracks.

    Args:
        layout: the lot.
        goal: (num_agents,) int32.
        tracked_bays: (num_agents, num_tracked_bays) int32.
        xy: (num_agents, 2) centres of the agents [m].

    Returns:
        (num_agents,) int32, and (num_agents,) bool, whether the bay exists.
    """
    rows = jnp.minimum(tracked_bays, layout.num_bays - 1)
    gap = norm(layout.bay_pose[rows, :2] - xy[:, None])
    rank = jnp.argmin(jnp.where(tracked_bays != NO_BAY, gap, jnp.inf), axis=1)
    near = jnp.take_along_axis(tracked_bays, rank[:, None], axis=1)[:, 0]
    bay = jnp.where(goal != NO_BAY, goal, near)
    return jnp.minimum(bay, layout.num_bays - 1), bay != NO_BAY
