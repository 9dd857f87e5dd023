"""Clearance: the gap from each agent's footprint to what it could hit."""

import functools

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_disc_distance, box_distance, norm
from carpark_mj.geometry.broad_phase import box_gaps, disc_gaps, is_crowded, least_near
from carpark_mj.geometry.gradients import with_gradient
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.collisions import reaches, strays
from carpark_mj.types import Motion, ParkedCars

KINDS = ("agent", "parked_car", "wall")  # what an agent can hit; discs are walls
RANGE = 20.0  # m, largest clearance reported
CHUNK = 2  # pairs per agent computed at a time: the nearest is among the first


def agent_clearance(motion: Motion) -> jax.Array:
    """Gap (num_agents,) [m] to the nearest other agent, as they stand; inf if alone."""
    num_agents = motion.size.shape[0]
    crowded = is_crowded(num_agents, num_agents)
    find = _near_agent_gap if crowded else _agent_gap
    return find(motion.pose_w, motion.size)


def _agent_gap(pose: jax.Array, size: jax.Array) -> jax.Array:
    """`agent_clearance` from all pairs."""
    own = jnp.eye(pose.shape[0], dtype=bool)
    gap = box_distance(pose[:, None], size[:, None], pose, size)
    return jnp.min(jnp.where(own, jnp.inf, gap), axis=0)


@functools.partial(with_gradient, like=_agent_gap)
def _near_agent_gap(pose: jax.Array, size: jax.Array) -> jax.Array:
    """`agent_clearance` from near pairs."""
    own = jnp.eye(pose.shape[0], dtype=bool)

    def find(index: jax.Array) -> jax.Array:
        return box_distance(pose[:, None], size[:, None], pose[index], size[index])

    reach = norm(size) / 2
    bound = box_gaps(pose[:, :2], pose, size) - reach[:, None]
    return least_near(jnp.where(own, jnp.inf, bound), find, jnp.inf, CHUNK)


def clearances(
    layout: Layout, motion: Motion, parked: ParkedCars
) -> dict[str, jax.Array]:
    """Gaps (num_agents,) [m] of the step by the names of `KINDS`.

    The smallest at the traced instants, those at which collisions are looked for: 0
    where footprints overlapped at one of them. At most `RANGE`.
    """
    others = ~jnp.eye(motion.size.shape[0], dtype=bool)
    to_agents = _box_clearance(
        motion, motion.trace_w, motion.size, strays(motion), others
    )
    to_parked = _box_clearance(
        motion, parked.pose_w[:, None], parked.size, 0.0, parked.present
    )
    to_walls = _box_clearance(
        motion, layout.wall_pose[:, None], layout.wall_size, 0.0, layout.wall_mask
    )
    to_discs = _disc_clearance(layout, motion)
    return {
        "agent": to_agents,
        "parked_car": to_parked,
        "wall": jnp.minimum(to_walls, to_discs),
    }


def _box_clearance(
    motion: Motion,
    trace: jax.Array,
    size: jax.Array,
    stray: jax.Array | float,
    mask: jax.Array,
) -> jax.Array:
    """Gaps (num_agents,) to the nearest of n boxes.

    Args:
        motion: the agents.
        trace: (n, k, 3) of the boxes, k = 1 for those that stand still.
        size: (n, 2) [m].
        stray: (n,) how far they are at most from where they end [m].
        mask: (n,) or (num_agents, n) bool, boxes that count.
    """
    own = motion.trace_w
    gap = box_gaps(own[:, -1, :2], trace[:, -1], size)
    bound = gap - stray - reaches(motion)[:, None]

    def find(index: jax.Array) -> jax.Array:
        own_size, other_size = motion.size[:, None, None], size[index][:, :, None]
        found = box_distance(own[:, None], own_size, trace[index], other_size)
        return jnp.min(found, axis=-1)

    return least_near(jnp.where(mask, bound, jnp.inf), find, RANGE, CHUNK)


def _disc_clearance(layout: Layout, motion: Motion) -> jax.Array:
    """Gaps (num_agents,) to the nearest disc."""
    own, centre, radius = motion.trace_w, layout.disc_centre, layout.disc_radius
    gap = disc_gaps(own[:, -1, :2], centre, radius)
    bound = gap - reaches(motion)[:, None]

    def find(index: jax.Array) -> jax.Array:
        where, reach = centre[index][:, :, None], radius[index][:, :, None]
        found = box_disc_distance(
            own[:, None], motion.size[:, None, None], where, reach
        )
        return jnp.min(found, axis=-1)

    return least_near(jnp.where(layout.disc_mask, bound, jnp.inf), find, RANGE, CHUNK)
