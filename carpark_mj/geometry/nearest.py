"""The nearest points, as array operations of fixed shape."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry.se2 import norm


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
    distance = norm(own_xy[:, None] - xy)
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
