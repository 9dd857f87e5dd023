"""Broad phase: exact tests only of what is near.

For every pair a cheap lower bound of the gap is worked out; the exact and costly test
then visits the pairs whose bound is below a limit, nearest first and a few per agent
at a time, until none is left. Nothing is missed however crowded the lot is, and the
cost of the tests grows with what is near. In small lots testing every pair is cheaper:
`is_crowded` decides by the static shapes, so that no key changes the program.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_corners, box_disc_overlap, boxes_overlap
from carpark_mj.types import Motion

# Pairs above which the bounds pay, measured by `eval/broad_phase.py`.
MANY_PAIRS = 500
# What float32 may lose of a bound at coordinates of some hundred metres.
MARGIN = 1e-3  # m
HITS_CHUNK = 3  # pairs per agent tested at a time for overlap: few are near

Carry = TypeVar("Carry")


def is_crowded(num_agents: int, num_others: int) -> bool:
    """Whether a lot has so many pairs of agents and others that the bounds pay."""
    return num_agents * num_others > MANY_PAIRS


def visit_near(
    bound: jax.Array,
    limit: Callable[[Carry], jax.Array],
    visit: Callable[[Carry, jax.Array, jax.Array], Carry],
    carry: Carry,
    chunk: int,
) -> Carry:
    """Visits for each agent everything whose bound is below its limit, nearest first.

    Args:
        bound: (num_agents, n) lower bounds [m]; inf or NaN is never visited.
        limit: of a carry, (num_agents,) [m]; it may shrink as the carry improves.
        visit: `(carry, index, valid) -> carry` with (num_agents, k) indices below n,
            each given once; those not valid must change nothing.
        carry: the first.
        chunk: how many to visit per agent at a time, k = min(chunk, n).

    Returns:
        The last carry.
    """
    chunk = min(chunk, bound.shape[1])
    rows = jnp.arange(bound.shape[0])[:, None]

    def is_left(state: tuple[jax.Array, Carry]) -> jax.Array:
        bound, carry = state
        return jnp.any(jnp.min(bound, axis=1) < limit(carry))

    def go_on(state: tuple[jax.Array, Carry]) -> tuple[jax.Array, Carry]:
        bound, carry = state
        near, index = jax.lax.top_k(-bound, chunk)
        carry = visit(carry, index, -near < limit(carry)[:, None])
        return bound.at[rows, index].set(jnp.inf), carry

    if chunk == 0:
        return carry
    bound = jnp.where(jnp.isnan(bound), jnp.inf, bound)
    return jax.lax.while_loop(is_left, go_on, (bound, carry))[1]


def least_near(
    bound: jax.Array,
    find: Callable[[jax.Array], jax.Array],
    limit: float,
    chunk: int,
) -> jax.Array:
    """The least number (num_agents,) of those found for each agent, at most `limit`.

    Args:
        bound: (num_agents, n) lower bounds of the numbers; see `visit_near`.
        find: the numbers (num_agents, k) at indices (num_agents, k).
        limit: what is larger need not be found.
        chunk: see `visit_near`.
    """

    def visit(least: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        found = jnp.where(valid, find(index), jnp.inf)
        return jnp.minimum(least, jnp.min(found, axis=1))

    start = jnp.full(bound.shape[0], limit, bound.dtype)
    return visit_near(bound, lambda least: least, visit, start, chunk)


def box_gaps(point: jax.Array, pose: jax.Array, size: jax.Array) -> jax.Array:
    """Distances (num_agents, n) [m] from points to boxes; 0 inside.

    `geometry.point_box_distance` of every pair, but by coordinates, which vectorises:
    on a CPU a table of many pairs takes a fifth of the time.

    Args:
        point: (num_agents, 2) [m].
        pose: (n, 3).
        size: (n, 2) [m].
    """
    cos, sin = jnp.cos(pose[:, 2]), jnp.sin(pose[:, 2])
    x = point[:, :1] - pose[:, 0]
    y = point[:, 1:] - pose[:, 1]
    ahead = jnp.maximum(jnp.abs(cos * x + sin * y) - 0.5 * size[:, 0], 0.0)
    aside = jnp.maximum(jnp.abs(cos * y - sin * x) - 0.5 * size[:, 1], 0.0)
    return jnp.sqrt(ahead * ahead + aside * aside)


def disc_gaps(point: jax.Array, centre: jax.Array, radius: jax.Array) -> jax.Array:
    """Distances (num_agents, n) [m] from points to the rims of discs; < 0 inside.

    Args:
        point: (num_agents, 2) [m].
        centre: (n, 2) [m].
        radius: (n,) [m].
    """
    x = point[:, :1] - centre[:, 0]
    y = point[:, 1:] - centre[:, 1]
    return jnp.sqrt(x * x + y * y) - radius


def near_box_hits(
    vehicle: Motion,
    pose: jax.Array,
    size: jax.Array,
    mask: jax.Array,
    kind: jax.Array,
) -> jax.Array:
    """Which kinds of boxes each agent overlapped at a traced instant.

    Args:
        vehicle: the agents (num_agents,).
        pose: (n, 3) boxes that stand still.
        size: (n, 2) [m].
        mask: (n,) bool, boxes that count.
        kind: (n,) int, 1 or 2.

    Returns:
        (num_agents, 3) bool: another agent, a box of kind 1, a box of kind 2.
    """
    trace = vehicle.trace_w
    num_agents, num_traces, _ = trace.shape
    still = jnp.broadcast_to(pose[:, None], (pose.shape[0], num_traces, 3))
    traces = jnp.concatenate([trace, still])
    sizes = jnp.concatenate([vehicle.size, size])
    kinds = jnp.concatenate([jnp.zeros(num_agents, kind.dtype), kind])
    others = ~jnp.eye(num_agents, dtype=bool)
    counts = jnp.broadcast_to(mask, (num_agents, pose.shape[0]))
    counts = jnp.concatenate([others, counts], axis=1)

    stray = jnp.concatenate([strays(vehicle), jnp.zeros(pose.shape[0])])
    bound = box_gaps(trace[:, -1, :2], traces[:, -1], sizes) - stray
    bound = jnp.where(counts, bound, jnp.inf)
    reach = reaches(vehicle)

    def test(hit: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        own_size, other_size = vehicle.size[:, None, None], sizes[index][:, :, None]
        overlap = boxes_overlap(trace[:, None], own_size, traces[index], other_size)
        found = overlap.any(axis=-1) & valid
        of_kind = kinds[index][..., None] == jnp.arange(3)
        return hit | jnp.any(found[..., None] & of_kind, axis=1)

    nothing = jnp.zeros((num_agents, 3), bool)
    return visit_near(bound, lambda _: reach, test, nothing, HITS_CHUNK)


def near_disc_hits(
    vehicle: Motion, centre: jax.Array, radius: jax.Array, mask: jax.Array
) -> jax.Array:
    """Whether each agent (num_agents,) overlapped a disc at a traced instant.

    Args:
        vehicle: the agents (num_agents,).
        centre: (n, 2) [m].
        radius: (n,) [m].
        mask: (n,) bool, discs that count.
    """
    trace = vehicle.trace_w
    bound = disc_gaps(trace[:, -1, :2], centre, radius)
    reach = reaches(vehicle)

    def test(hit: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        own_size = vehicle.size[:, None, None]
        where, size = centre[index][:, :, None], radius[index][:, :, None]
        overlap = box_disc_overlap(trace[:, None], own_size, where, size)
        return hit | jnp.any(overlap.any(axis=-1) & valid, axis=1)

    nothing = jnp.zeros(trace.shape[0], bool)
    bound = jnp.where(mask, bound, jnp.inf)
    return visit_near(bound, lambda _: reach, test, nothing, HITS_CHUNK)


def strays(vehicle: Motion) -> jax.Array:
    """How far (num_agents,) [m] points of the agents' boxes are from where they end."""
    # A rigid motion moves a corner farthest.
    corners = box_corners(vehicle.trace_w, vehicle.size[:, None])
    return jnp.linalg.norm(corners - corners[:, -1:], axis=-1).max(axis=(1, 2))


def reaches(vehicle: Motion) -> jax.Array:
    """Radii (num_agents,) [m] about where agents end that hold all of their traces."""
    way = vehicle.trace_w[..., :2] - vehicle.trace_w[:, -1:, :2]
    way = jnp.linalg.norm(way, axis=-1).max(axis=1)
    return jnp.linalg.norm(vehicle.size, axis=-1) / 2 + way + MARGIN
