"""Which other agents an agent tracks, as a matrix."""

import jax
import jax.numpy as jnp

from carpark_mj.observations.localised import nearest


def tracked_agents(
    pose_w: jax.Array,
    parked_pose: jax.Array,
    count: int,
    parked_present: jax.Array | None = None,
) -> jax.Array:
    """Who tracks whom: the nearest cars, agents and parked cars alike, by centres.

    Args:
        pose_w: (num_agents, 3).
        parked_pose: (num_parked_cars, 3); none where only agents are tracked.
        count: cars that an agent tracks (n_track).
        parked_present: (num_parked_cars,) bool; None = all.

    Returns:
        (num_agents, num_agents) bool, [i, j] whether agent i tracks agent j.
    """
    num_agents = pose_w.shape[0]
    if count == 0:
        return jnp.zeros((num_agents, num_agents), bool)
    xy = jnp.concatenate([pose_w[:, :2], parked_pose[:, :2]])
    present = jnp.ones(xy.shape[0], bool)
    if parked_present is not None:
        present = present.at[num_agents:].set(parked_present)
    mask = present & ~jnp.eye(num_agents, xy.shape[0], dtype=bool)
    index, found = nearest(pose_w[:, :2], xy, mask, count)
    hit = (index[:, :, None] == jnp.arange(num_agents)) & found[:, :, None]
    return hit.any(axis=1)
