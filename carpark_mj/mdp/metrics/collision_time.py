"""Time to collision: when each agent would hit something if all cars drove straight on.

Time to collision as of Hayward 1972 ("Near-miss determination through use of a scale of
danger": the time until two cars collide "if they continue at their present speed and on
the same path"), in the plane: every car continues with the velocity of its rear axle
and its present heading, and footprints are boxes. Turning is ignored, so a car that is
steering clear of a wall has a finite time to it.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm, rotate
from carpark_mj.geometry.broad_phase import MARGIN, least_near
from carpark_mj.geometry.obstacles import Group, take
from carpark_mj.mdp.clearance import least_by_kind
from carpark_mj.types import Motion

HORIZON = 10.0  # s, longest time reported
CHUNK = 2  # pairs per agent computed at a time


def collision_times(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Times (num_agents,) [s] by the labels of `ObstacleKind`; see above.

    0 where footprints overlap, at most `HORIZON`.
    """
    return least_by_kind(obstacles, lambda group: _contact_time(motion, group))


def _contact_time(motion: Motion, group: Group) -> jax.Array:
    """Times (num_agents,) to the first collision with any of a group."""
    pose, size = motion.pose_w[:, None], motion.size[:, None]
    own = rotate(motion.velocity_b, motion.pose_w[..., 2])[:, None]
    gap = group.gaps(motion.pose_w[:, :2])
    relative = own if group.velocity_w is None else own - group.velocity_w

    def find(index: jax.Array) -> jax.Array:
        near = take(group, index)
        towards = own if near.velocity_w is None else own - near.velocity_w
        return near.contact_time(pose, size, towards)

    counts = group.counts(motion.size.shape[0])
    bound = jnp.where(counts, _bound(motion, gap, relative), jnp.inf)
    return least_near(bound, find, HORIZON, CHUNK)


def _bound(motion: Motion, gap: jax.Array, relative: jax.Array) -> jax.Array:
    """Lower bounds (num_agents, n) of the times [s]: the gap over the relative speed.

    Args:
        motion: the agents.
        gap: (num_agents, n) from their centres to the others' outlines [m].
        relative: (num_agents, n or 1, 2) velocities towards them [m/s].
    """
    free = gap - norm(motion.size)[:, None] / 2 - MARGIN
    time = free / norm(relative)  # inf if they keep their distance
    return jnp.where(free > 0.0, time, 0.0)
