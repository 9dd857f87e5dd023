"""Time to collision: when each agent would hit something if all cars drove straight on.

Time to collision as of Hayward 1972 ("Near-miss determination through use of a scale of
danger": the time until two cars collide "if they continue at their present speed and on
the same path"), in the plane: every car continues with the velocity of its rear axle
and its present heading, and footprints are boxes. Turning is ignored, so a car that is
steering clear of a wall has a finite time to it.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_contact_time, box_disc_contact_time, norm, rotate
from carpark_mj.geometry.broad_phase import MARGIN, box_gaps, disc_gaps, least_near
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion, ParkedCars

HORIZON = 10.0  # s, longest time reported
CHUNK = 2  # pairs per agent computed at a time


def collision_times(
    layout: Layout, motion: Motion, parked: ParkedCars
) -> dict[str, jax.Array]:
    """Times (num_agents,) [s] by the names of `clearance.KINDS`; see above.

    0 where footprints overlap, at most `HORIZON`.
    """
    pose, size = motion.pose_w, motion.size
    others = ~jnp.eye(size.shape[0], dtype=bool)
    velocity_w = rotate(motion.velocity_b, pose[..., 2])
    to_agents = _to_boxes(motion, pose, size, velocity_w, others)
    to_parked = _to_boxes(motion, parked.pose_w, parked.size, None, parked.present)
    to_walls = _to_boxes(
        motion, layout.wall_pose, layout.wall_size, None, layout.wall_mask
    )
    to_discs = _to_discs(layout, motion)
    return {
        "agent": to_agents,
        "parked_car": to_parked,
        "wall": jnp.minimum(to_walls, to_discs),
    }


def _to_boxes(
    motion: Motion,
    pose: jax.Array,
    size: jax.Array,
    velocity_w: jax.Array | None,
    mask: jax.Array,
) -> jax.Array:
    """Times (num_agents,) to the first collision with any of n boxes.

    Args:
        motion: the agents.
        pose: (n, 3) of the boxes.
        size: (n, 2) [m].
        velocity_w: (n, 2) [m/s]; None = they stand still.
        mask: (n,) or (num_agents, n) bool, boxes that count.
    """
    own = rotate(motion.velocity_b, motion.pose_w[..., 2])
    other = jnp.zeros_like(pose[:, :2]) if velocity_w is None else velocity_w
    relative = own[:, None] - other
    gap = box_gaps(motion.pose_w[:, :2], pose, size)

    def find(index: jax.Array) -> jax.Array:
        return box_contact_time(
            motion.pose_w[:, None],
            motion.size[:, None],
            pose[index],
            size[index],
            jnp.take_along_axis(relative, index[..., None], axis=1),
        )

    return least_near(_bound(motion, gap, relative, mask), find, HORIZON, CHUNK)


def _to_discs(layout: Layout, motion: Motion) -> jax.Array:
    """Times (num_agents,) to the first collision with any disc."""
    centre, radius = layout.disc_centre, layout.disc_radius
    own = rotate(motion.velocity_b, motion.pose_w[..., 2])[:, None]
    gap = disc_gaps(motion.pose_w[:, :2], centre, radius)

    def find(index: jax.Array) -> jax.Array:
        return box_disc_contact_time(
            motion.pose_w[:, None],
            motion.size[:, None],
            centre[index],
            radius[index],
            own,
        )

    bound = _bound(motion, gap, own, layout.disc_mask)
    return least_near(bound, find, HORIZON, CHUNK)


def _bound(
    motion: Motion, gap: jax.Array, relative: jax.Array, mask: jax.Array
) -> jax.Array:
    """Lower bounds (num_agents, n) of the times [s]: the gap over the relative speed.

    Args:
        motion: the agents.
        gap: (num_agents, n) from their centres to the others' outlines [m].
        relative: (num_agents, n or 1, 2) velocities towards them [m/s].
        mask: (n,) or (num_agents, n) bool, others that count.
    """
    way = gap - norm(motion.size)[:, None] / 2 - MARGIN
    time = way / norm(relative)  # inf if they keep their distance
    return jnp.where(mask, jnp.where(way > 0.0, time, 0.0), jnp.inf)
