"""Broad phase: exact tests of near pairs only.

Every pair gets a cheap lower bound of its gap. The exact and costly test then visits
the pairs whose bound is below a limit, nearest first and a few per agent at a time,
until none is left. The result is exact in any lot, and the cost of the tests grows with
the number of near pairs. In small lots testing every pair is cheaper: `is_crowded`
decides by the static shapes, so that no key changes the program.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

# Pairs above which the bounds pay, measured on two CPU cores.
MANY_PAIRS = 500
# What float32 may lose of a bound at coordinates of some hundred metres.
MARGIN = 1e-3  # m

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
    bound: jax.Array, find: Callable[[jax.Array], jax.Array], limit: float, chunk: int
) -> jax.Array:
    """The least number (num_agents,) of those found for each agent, at most `limit`.

    `bound` (num_agents, n) has lower bounds of the numbers, `find` gives the numbers
    (num_agents, k) at indices (num_agents, k); see `visit_near`.
    """

    def visit(least: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        found = jnp.where(valid, find(index), jnp.inf)
        return jnp.minimum(least, jnp.min(found, axis=1))

    start = jnp.full(bound.shape[0], limit, bound.dtype)
    return visit_near(bound, lambda least: least, visit, start, chunk)


def box_gaps(point: jax.Array, pose: jax.Array, size: jax.Array) -> jax.Array:
    """Distances (num_agents, n) [m] from points (num_agents, 2) to boxes; 0 inside.

    `geometry.point_box_distance` of every pair, but by coordinates, which vectorises:
    on a CPU a table of many pairs takes a fifth of the time.
    """
    cos, sin = jnp.cos(pose[:, 2]), jnp.sin(pose[:, 2])
    x = point[:, :1] - pose[:, 0]
    y = point[:, 1:] - pose[:, 1]
    ahead = jnp.maximum(jnp.abs(cos * x + sin * y) - 0.5 * size[:, 0], 0.0)
    aside = jnp.maximum(jnp.abs(cos * y - sin * x) - 0.5 * size[:, 1], 0.0)
    return jnp.sqrt(ahead * ahead + aside * aside)


def disc_gaps(point: jax.Array, centre: jax.Array, radius: jax.Array) -> jax.Array:
    """Distances (num_agents, n) [m] from points to the rims of discs; < 0 inside."""
    x = point[:, :1] - centre[:, 0]
    y = point[:, 1:] - centre[:, 1]
    return jnp.sqrt(x * x + y * y) - radius
