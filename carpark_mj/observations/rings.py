"""Proximity rings: how many objects a circle about the car touches, now and before.

Objects are whole walls, discs and, with `ObservationConfig.ring_cars`, parked cars and
other agents.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import ObservationConfig
from carpark_mj.geometry import point_box_distance
from carpark_mj.geometry.broad_phase import disc_gaps
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import ring_names
from carpark_mj.types import Motion


def count_rings(
    config: ObservationConfig,
    layout: Layout,
    vehicle: Motion,
    parked_pose: jax.Array,
    parked_size: jax.Array,
) -> jax.Array:
    """Counts (num_agents, rings) int32, up to the cap.

    Every object is looked at: nothing cheaper than this distance could rule it out.

    Args:
        config: the rings.
        layout: the lot.
        vehicle: the agents (num_agents,), at the circles' centres.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
    """
    own_xy = vehicle.pose_w[:, :2]
    gap = point_box_distance(own_xy[:, None], layout.wall_pose, layout.wall_size)
    gap = jnp.where(layout.wall_mask, gap, jnp.inf)
    if layout.disc_mask.shape[0]:
        discs = disc_gaps(own_xy, layout.disc_centre, layout.disc_radius)
        discs = jnp.where(layout.disc_mask, discs, jnp.inf)
        gap = jnp.concatenate([gap, discs], axis=1)
    if config.ring_cars:
        own = jnp.eye(own_xy.shape[0], dtype=bool)
        agents = point_box_distance(own_xy[:, None], vehicle.pose_w, vehicle.size)
        agents = jnp.where(own, jnp.inf, agents)
        parked = point_box_distance(own_xy[:, None], parked_pose, parked_size)
        gap = jnp.concatenate([gap, agents, parked], axis=1)
    radii = jnp.array(config.rings, gap.dtype) / 2
    count = jnp.sum(gap[:, :, None] < radii, axis=1)
    return jnp.minimum(count, config.ring_cap)


def init_history(config: ObservationConfig, num_agents: int) -> jax.Array | None:
    """Past counts (num_agents, ring_history, rings) int32, oldest first: zeros.

    None if the past is not seen.
    """
    if not config.ring_history:
        return None
    return jnp.zeros((num_agents, config.ring_history, len(config.rings)), jnp.int32)


def remember(history: jax.Array, count: jax.Array) -> jax.Array:
    """The past after counts (num_agents, rings) have been seen."""
    return jnp.concatenate([history[:, 1:], count[:, None].astype(jnp.int32)], axis=1)


def forget(history: jax.Array | None, respawned: jax.Array) -> jax.Array | None:
    """The past with zeros for agents (num_agents,) that start a new episode."""
    if history is None:
        return None
    return jnp.where(respawned[:, None, None], 0, history)


def ring_counts(
    config: ObservationConfig, now: jax.Array, history: jax.Array | None
) -> dict[str, jax.Array]:
    """Counts (num_agents, rings) and those remembered by name, (num_agents, 1) each.

    A history of None is one without anything seen.
    """
    counts = now
    if config.ring_history:
        if history is None:
            shape = (now.shape[0], config.ring_history * len(config.rings))
            history = jnp.zeros(shape, now.dtype)
        counts = jnp.concatenate([now, history.reshape(now.shape[0], -1)], axis=1)
    return {name: counts[:, k : k + 1] for k, name in enumerate(ring_names(config))}
