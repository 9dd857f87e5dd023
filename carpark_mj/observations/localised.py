"""The nearest other cars as poses in the observer's body frame."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import to_local
from carpark_mj.observations.fields import FAR, NEAR


def nearest(
    own_xy: jax.Array, xy: jax.Array, mask: jax.Array, count: int
) -> tuple[jax.Array, jax.Array]:
    """Indices of the nearest points, nearest first.

    Args:
        own_xy: (num_agents, 2) observers.
        xy: (n, 2) candidates.
        mask: (num_agents, n) bool, candidates that count.
        count: how many to return; padded where there are fewer.

    Returns:
        (num_agents, count) int indices and (num_agents, count) bool, whether present.
    """
    distance = jnp.linalg.norm(own_xy[:, None] - xy, axis=-1)
    distance = jnp.where(mask, distance, jnp.inf)
    missing = max(count - distance.shape[1], 0)
    distance = jnp.pad(distance, ((0, 0), (0, missing)), constant_values=jnp.inf)
    # A few rounds of argmin are cheaper than sorting when few cars are tracked.
    indices, present = [], []
    columns = jnp.arange(distance.shape[1])
    for _ in range(count):
        index = jnp.argmin(distance, axis=1)
        present.append(jnp.isfinite(jnp.min(distance, axis=1)))
        indices.append(jnp.minimum(index, max(xy.shape[0] - 1, 0)))
        distance = jnp.where(columns == index[:, None], jnp.inf, distance)
    return jnp.stack(indices, axis=1), jnp.stack(present, axis=1)


def localise(
    own_pose: jax.Array, pose: jax.Array, size: jax.Array, present: jax.Array
) -> dict[str, jax.Array]:
    """Describes tracked cars in the observers' frames.

    Args:
        own_pose: (num_agents, 3) observers.
        pose: (num_agents, count, 3) tracked cars, world frame.
        size: (num_agents, count, 2) [m].
        present: (num_agents, count) bool; absent cars give zeros.

    Returns:
        Fields (num_agents, count, k), named as in `fields`.
    """
    local = to_local(own_pose[:, None], pose)
    xy = local[..., :2]
    values = {
        "present": jnp.ones_like(local[..., :1]),
        "position": xy / FAR,
        "near_position": jnp.clip(xy / (2 * NEAR), -1.0, 1.0),
        "heading": jnp.stack([jnp.cos(local[..., 2]), jnp.sin(local[..., 2])], axis=-1),
        "size": size / 5.0,
    }
    return {
        name: jnp.where(present[..., None], value, 0.0)
        for name, value in values.items()
    }
