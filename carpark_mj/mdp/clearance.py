"""Clearance: the gap from each agent's footprint to the nearest obstacle."""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_distance, norm
from carpark_mj.geometry.broad_phase import box_gaps, is_crowded, least_near
from carpark_mj.geometry.obstacles import Group, take
from carpark_mj.geometry.se2 import with_gradient
from carpark_mj.mdp.collisions import trace_radius
from carpark_mj.types import Motion

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


def clearances(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Gaps (num_agents,) [m] of the step by the labels of `ObstacleKind`.

    The smallest gap at the traced instants, where collisions are tested: 0 if
    footprints overlapped at one of them. At most `RANGE`.
    """
    return least_by_kind(obstacles, lambda group: _clearance(motion, group))


def least_by_kind(
    obstacles: Sequence[Group], find: Callable[[Group], jax.Array]
) -> dict[str, jax.Array]:
    """The least of the numbers (num_agents,) of groups, by the kinds' labels."""
    least: dict[str, jax.Array] = {}
    for group in obstacles:
        label, found = group.kind.label, find(group)
        least[label] = jnp.minimum(least[label], found) if label in least else found
    return least


def _clearance(motion: Motion, group: Group) -> jax.Array:
    """Gaps (num_agents,) to the nearest of a group."""
    own, traced = motion.trace_w, group.traced
    bound = group.gaps(own[:, -1, :2]) - group.excursion - trace_radius(motion)[:, None]

    def find(index: jax.Array) -> jax.Array:
        own_size = motion.size[:, None, None]
        found = take(traced, index).distance(own[:, None], own_size)
        return jnp.min(found, axis=-1)

    counts = group.counts(motion.size.shape[0])
    return least_near(jnp.where(counts, bound, jnp.inf), find, RANGE, CHUNK)
