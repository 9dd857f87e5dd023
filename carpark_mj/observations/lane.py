"""What an agent knows of the lane it is in."""

import jax
import jax.numpy as jnp

from carpark_mj.layouts.lanes import has_lanes, nearest_lane
from carpark_mj.layouts.types import Layout


def own_lane(layout: Layout, own_pose: jax.Array) -> dict[str, jax.Array]:
    """The nearest lane seen by every agent (num_agents, 3); zeros without lanes."""
    if not has_lanes(layout):
        zero = jnp.zeros((own_pose.shape[0], 1))
        return {
            "lane_present": zero,
            "lane_heading": jnp.concatenate([zero, zero], axis=-1),
            "lane_one_way": zero,
        }
    index, present = nearest_lane(layout, own_pose)
    yaw = layout.lane_pose[index, 2] - own_pose[:, 2]
    values = {
        "lane_present": present[:, None],
        "lane_heading": jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1),
        "lane_one_way": layout.lane_one_way[index, None],
    }
    return {
        name: jnp.where(present[:, None], value, 0.0) for name, value in values.items()
    }
