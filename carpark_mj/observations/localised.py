"""Other cars as poses in the observer's body frame."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import to_local
from carpark_mj.observations.fields import FAR, FARTHEST, LENGTH, NEAR, Field, far

POSE_FIELDS = (
    Field(
        "position",
        2,
        -FARTHEST,
        FARTHEST,
        f"its centre, x and y, body frame [{FAR:g} m]",
        metres=FAR,
    ),
    Field("near_position", 2, -1.0, 1.0, f"the same [{NEAR * 2:g} m], clipped"),
    Field("heading", 2, -1.0, 1.0, "cos and sin of its heading minus own"),
)
CAR_FIELDS = (
    Field(
        "present",
        1,
        0.0,
        1.0,
        "1 if there is such a car; else all its numbers are 0",
        is_mask=True,
    ),
    *POSE_FIELDS,
    Field("size", 2, 0.0, 2.0, f"length and width [{LENGTH:g} m]"),
)


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
        `CAR_FIELDS` (num_agents, count, k).
    """
    local = to_local(own_pose[:, None], pose)
    xy = local[..., :2]
    values = {
        "present": jnp.ones_like(local[..., :1]),
        "position": far(xy),
        "near_position": jnp.clip(xy / (2 * NEAR), -1.0, 1.0),
        "heading": jnp.stack([jnp.cos(local[..., 2]), jnp.sin(local[..., 2])], axis=-1),
        "size": size / LENGTH,
    }
    return {
        name: jnp.where(present[..., None], value, 0.0)
        for name, value in values.items()
    }
