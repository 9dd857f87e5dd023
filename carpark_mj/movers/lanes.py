"""The lane of a lot that a mover belongs to."""

import jax
import jax.numpy as jnp

from carpark_mj.layouts.types import Layout


def draw_lane(
    key: jax.Array, layout: Layout, least: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """A lane at random.

    Args:
        key: consumed.
        layout: the lot.
        least: its least length [m].

    Returns:
        Pose (3,), size (2,), and () bool, whether the lot has such a lane.
    """
    if not layout.lane_mask.shape[0]:
        return jnp.zeros(3), jnp.ones(2), jnp.bool_(False)
    good = layout.lane_mask & (layout.lane_size[:, 0] >= least)
    order = jax.random.uniform(key, good.shape)
    lane = jnp.argmax(jnp.where(good, order, -1.0))
    return layout.lane_pose[lane], layout.lane_size[lane], good[lane]
