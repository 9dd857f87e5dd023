"""Collisions: what each agent touched during a step.

Physics with contacts reports them; otherwise footprints are tested for overlap at
every traced instant, of near pairs only where a lot is crowded.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_corners, box_disc_overlap, boxes_overlap, norm
from carpark_mj.geometry.broad_phase import (
    MARGIN,
    box_gaps,
    disc_gaps,
    is_crowded,
    visit_near,
)
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion, ParkedCars, State

HITS_CHUNK = 3  # pairs per agent tested at a time for overlap: few are near


class Hits(NamedTuple):
    """What agents touched in a step; (num_agents,) bool each.

    Attributes:
        agent: another agent; in a collision of two agents both are hit.
        parked_car: a parked car.
        wall: a wall or disc (pillar, bollard).
    """

    agent: jax.Array
    parked_car: jax.Array
    wall: jax.Array

    @property
    def any(self) -> jax.Array:
        """(num_agents,) bool, anything."""
        return self.agent | self.parked_car | self.wall


def find_hits(state: State, hitbox_scale: jax.Array | float = 1.0) -> Hits:
    """What each agent touched during the step that led to a state.

    Args:
        state: of the lot at the end of the step.
        hitbox_scale: () factor on all cars' lengths and widths. It has no effect in
            physics with contacts.
    """
    motion, parked_cars = state.motion, state.parked_cars
    if motion.touched is not None:
        return Hits(*jnp.moveaxis(motion.touched, -1, 0))
    motion = dataclasses.replace(motion, size=motion.size * hitbox_scale)
    size = parked_cars.size * hitbox_scale
    parked_cars = dataclasses.replace(parked_cars, size=size)
    agent, parked_car, wall = _box_hits(state.layout, motion, parked_cars)
    return Hits(agent, parked_car, wall | _disc_hits(state.layout, motion))


def _box_hits(layout: Layout, motion: Motion, parked_cars: ParkedCars) -> Hits:
    """Who overlapped another agent, a parked car, a wall; (num_agents,) bool each."""
    parked_pose, parked_size = parked_cars.pose_w, parked_cars.size
    num_agents, num_parked = motion.size.shape[0], parked_size.shape[0]
    num_walls = layout.wall_mask.shape[0]
    if is_crowded(num_agents, num_agents + num_parked + num_walls):
        hits = near_box_hits(
            motion,
            jnp.concatenate([parked_pose, layout.wall_pose]),
            jnp.concatenate([parked_size, layout.wall_size]),
            jnp.concatenate([jnp.ones(num_parked, bool), layout.wall_mask]),
            1 + (jnp.arange(num_parked + num_walls) >= num_parked),
        )
        return Hits(hits[:, 0], hits[:, 1], hits[:, 2])
    own = motion.trace_w[:, None]  # (agents, 1, traces, 3)
    own_size = motion.size[:, None, None]
    agents = boxes_overlap(
        own, own_size, motion.trace_w[None], motion.size[None, :, None]
    )
    agents = agents & ~jnp.eye(num_agents, dtype=bool)[..., None]
    parked = boxes_overlap(
        own, own_size, parked_pose[None, :, None], parked_size[None, :, None]
    )
    walls = boxes_overlap(
        own, own_size, layout.wall_pose[None, :, None], layout.wall_size[None, :, None]
    )
    walls = walls & layout.wall_mask[None, :, None]
    return Hits(agents.any((1, 2)), parked.any((1, 2)), walls.any((1, 2)))


def _disc_hits(layout: Layout, motion: Motion) -> jax.Array:
    """Who overlapped a disc; (num_agents,) bool."""
    centre, radius, mask = layout.disc_centre, layout.disc_radius, layout.disc_mask
    if is_crowded(motion.size.shape[0], mask.shape[0]):
        return near_disc_hits(motion, centre, radius, mask)
    discs = box_disc_overlap(
        motion.trace_w[:, None],
        motion.size[:, None, None],
        centre[None, :, None],
        radius[None, :, None],
    )
    return (discs & mask[None, :, None]).any((1, 2))


def near_box_hits(
    motion: Motion,
    pose: jax.Array,
    size: jax.Array,
    mask: jax.Array,
    kind: jax.Array,
) -> jax.Array:
    """Which kinds of boxes each agent overlapped at a traced instant.

    Args:
        motion: the agents (num_agents,).
        pose: (n, 3) boxes that stand still.
        size: (n, 2) [m].
        mask: (n,) bool, boxes that count.
        kind: (n,) int, 1 or 2.

    Returns:
        (num_agents, 3) bool: another agent, a box of kind 1, a box of kind 2.
    """
    trace = motion.trace_w
    num_agents, num_traces, _ = trace.shape
    still = jnp.broadcast_to(pose[:, None], (pose.shape[0], num_traces, 3))
    traces = jnp.concatenate([trace, still])
    sizes = jnp.concatenate([motion.size, size])
    kinds = jnp.concatenate([jnp.zeros(num_agents, kind.dtype), kind])
    others = ~jnp.eye(num_agents, dtype=bool)
    counts = jnp.broadcast_to(mask, (num_agents, pose.shape[0]))
    counts = jnp.concatenate([others, counts], axis=1)

    stray = jnp.concatenate([strays(motion), jnp.zeros(pose.shape[0])])
    bound = box_gaps(trace[:, -1, :2], traces[:, -1], sizes) - stray
    bound = jnp.where(counts, bound, jnp.inf)
    reach = reaches(motion)

    def test(hit: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        own_size, other_size = motion.size[:, None, None], sizes[index][:, :, None]
        overlap = boxes_overlap(trace[:, None], own_size, traces[index], other_size)
        found = overlap.any(axis=-1) & valid
        of_kind = kinds[index][..., None] == jnp.arange(3)
        return hit | jnp.any(found[..., None] & of_kind, axis=1)

    nothing = jnp.zeros((num_agents, 3), bool)
    return visit_near(bound, lambda _: reach, test, nothing, HITS_CHUNK)


def near_disc_hits(
    motion: Motion, centre: jax.Array, radius: jax.Array, mask: jax.Array
) -> jax.Array:
    """Whether each agent (num_agents,) overlapped a disc at a traced instant.

    Args:
        motion: the agents (num_agents,).
        centre: (n, 2) [m].
        radius: (n,) [m].
        mask: (n,) bool, discs that count.
    """
    trace = motion.trace_w
    bound = disc_gaps(trace[:, -1, :2], centre, radius)
    reach = reaches(motion)

    def test(hit: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        own_size = motion.size[:, None, None]
        where, size = centre[index][:, :, None], radius[index][:, :, None]
        overlap = box_disc_overlap(trace[:, None], own_size, where, size)
        return hit | jnp.any(overlap.any(axis=-1) & valid, axis=1)

    nothing = jnp.zeros(trace.shape[0], bool)
    bound = jnp.where(mask, bound, jnp.inf)
    return visit_near(bound, lambda _: reach, test, nothing, HITS_CHUNK)


def strays(motion: Motion) -> jax.Array:
    """How far (num_agents,) [m] points of the agents' boxes are from where they end."""
    # A rigid motion moves a corner farthest.
    corners = box_corners(motion.trace_w, motion.size[:, None])
    return norm(corners - corners[:, -1:]).max(axis=(1, 2))


def reaches(motion: Motion) -> jax.Array:
    """Radii (num_agents,) [m] about where agents end that hold all of their traces."""
    way = motion.trace_w[..., :2] - motion.trace_w[:, -1:, :2]
    way = norm(way).max(axis=1)
    return norm(motion.size) / 2 + way + MARGIN
