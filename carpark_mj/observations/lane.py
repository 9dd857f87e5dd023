"""What an agent observes of the lane it is in."""

import jax
import jax.numpy as jnp

from carpark_mj.layouts.lanes import has_lanes, nearest_lane
from carpark_mj.observations.fields import Field
from carpark_mj.observations.parts import Part, Sight

_FIELDS = (
    Field("lane_present", 1, 0.0, 1.0, "1 if the lot has lanes; else all 0"),
    Field("lane_heading", 2, -1.0, 1.0, "cos and sin of its heading minus own"),
    Field("lane_one_way", 1, 0.0, 1.0, "1 if only that direction is right"),
)


def _nearest(sight: Sight) -> dict[str, jax.Array]:
    """Of the lane nearest to every agent; zeros without lanes."""
    layout, own_pose = sight.layout, sight.motion.pose_w
    if not has_lanes(layout):
        count = own_pose.shape[0]
        return {field.name: jnp.zeros((count, field.size)) for field in _FIELDS}
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


LANE = Part(_FIELDS, _nearest)
