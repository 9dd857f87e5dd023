"""Collisions: the obstacles that each agent touched during a step.

Physics with contacts reports them. Otherwise, and with movers in any case, footprints
are tested for overlap at every traced instant, and in between with discs, which may be
thin; in crowded lots near pairs only.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import norm
from carpark_mj.geometry.broad_phase import MARGIN, is_crowded, visit_near
from carpark_mj.geometry.obstacles import Group, Merged, by_shape, merge, take
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import Motion, State

HITS_CHUNK = 3  # pairs per agent tested at a time for overlap: few are near


def find_hits(
    state: State, hitbox_scale: jax.Array | float = 1.0
) -> dict[str, jax.Array]:
    """What each agent touched during the step that led to a state.

    Args:
        state: of the lot at the end of the step.
        hitbox_scale: () factor on all cars' lengths and widths. It has no effect in
            physics with contacts.

    Returns:
        (num_agents,) bool by the labels of `ObstacleKind`; in a collision of two agents
        both are hit.
    """
    motion, parked_cars, movers = state.motion, state.parked_cars, state.movers
    if motion.touched is not None:
        always = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR, ObstacleKind.WALL)
        kinds = {*always, *(group.kind for group in movers.groups)}
        columns = jnp.moveaxis(motion.touched, -1, 0)
        hits = {k: columns[k] for k in sorted(kinds) if k < columns.shape[0]}
        return _labelled(_add_hits(hits, motion, movers.groups))
    motion = dataclasses.replace(motion, size=motion.size * hitbox_scale)
    size = parked_cars.size * hitbox_scale
    parked_cars = dataclasses.replace(parked_cars, size=size)
    obstacles = lot_obstacles(state.layout, motion, parked_cars, movers)
    return _labelled(_add_hits({}, motion, obstacles))


_Hits = dict[ObstacleKind, jax.Array]


def _labelled(hits: _Hits) -> dict[str, jax.Array]:
    return {kind.label: hit for kind, hit in hits.items()}


def _add_hits(hits: _Hits, motion: Motion, groups: Sequence[Group]) -> _Hits:
    """Hits and those of more obstacles, by kind."""
    num_agents, hits = motion.size.shape[0], dict(hits)
    for same in by_shape(groups):
        if is_crowded(num_agents, sum(group.count for group in same)):
            found = _near_hits(motion, merge(same, num_agents))
        else:
            found = [(group.kind, _group_hits(motion, group)) for group in same]
        for kind, hit in found:
            hits[kind] = hits[kind] | hit if kind in hits else hit
    return hits


def _group_hits(motion: Motion, group: Group) -> jax.Array:
    """Agents (num_agents,) bool that hit any of a group."""
    own, own_size = motion.trace_w[:, None], motion.size[:, None, None]
    hit = group.traced.hit(own, own_size)
    counts = group.counts(motion.size.shape[0])
    return (hit & counts[..., None]).any((1, 2))


def _near_hits(motion: Motion, them: Merged) -> list[tuple[ObstacleKind, jax.Array]]:
    """Like `_group_hits`, for the near ones of many obstacles of a shape, by kind."""
    trace, traced = motion.trace_w, them.group.traced
    bound = them.group.gaps(trace[:, -1, :2]) - them.excursion
    bound = jnp.where(them.counts, bound, jnp.inf)
    reach = trace_radius(motion)
    kinds, column = np.unique(them.kind, return_inverse=True)

    def test(hit: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        own_size = motion.size[:, None, None]
        hits = take(traced, index).hit(trace[:, None], own_size)
        found = hits.any(axis=-1) & valid
        of_kind = jnp.asarray(column)[index][..., None] == jnp.arange(len(kinds))
        return hit | jnp.any(found[..., None] & of_kind, axis=1)

    nothing = jnp.zeros((trace.shape[0], len(kinds)), bool)
    hits = visit_near(bound, lambda _: reach, test, nothing, HITS_CHUNK)
    return [(ObstacleKind(kind), hits[:, k]) for k, kind in enumerate(kinds)]


def trace_radius(motion: Motion) -> jax.Array:
    """Radii (num_agents,) [m] of circles about final centres that hold all traces."""
    offset = motion.trace_w[..., :2] - motion.trace_w[:, -1:, :2]
    return norm(motion.size) / 2 + norm(offset).max(axis=1) + MARGIN
