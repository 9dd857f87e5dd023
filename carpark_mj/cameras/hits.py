"""Hits of rays as whole numbers whose order is that of the distance.

So a running minimum keeps what is hit, too: a hit is the bits of the distance
(float32), the last seven of which hold the shade and what is seen. That costs 16 um of
depth a metre.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

SEEN_BITS, SHADE_BITS = 4, 3
SHADES = 2**SHADE_BITS - 1  # the brightest
_LOW = 2 ** (SEEN_BITS + SHADE_BITS) - 1
_INFINITY = 0x7F800000  # its bits
MISS = 2**31 - 1  # after all others
CHUNK = 8  # things that a pass over the pixels meets

Tree = TypeVar("Tree")


def encode(
    distance: jax.Array, seen: jax.Array | int, shade: jax.Array | int
) -> jax.Array:
    """Hits of distances [m], at least 0, of what is seen and shades up to `SHADES`."""
    bits = jax.lax.bitcast_convert_type(distance, jnp.int32)
    return (bits & ~_LOW) | (shade << SEEN_BITS) | seen


def sky_hit(seen: int) -> int:
    """The hit of a ray that meets nothing."""
    return _INFINITY | (SHADES << SEEN_BITS) | seen


def decode(hit: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Distances [m], what is seen, and shades."""
    far = hit >= _INFINITY
    middle = (hit & ~_LOW) | (_LOW // 2)  # of what has been cut off
    bits = jnp.where(far, _INFINITY, middle)
    distance = jax.lax.bitcast_convert_type(bits, jnp.float32)
    return distance, hit & (2**SEEN_BITS - 1), (hit >> SEEN_BITS) & SHADES


def fold(
    best: jax.Array,
    things: Tree,
    padding: Tree,
    meet: Callable[[jax.Array, Tree], jax.Array],
    matters: jax.Array | None = None,
) -> jax.Array:
    """Meets things one after the other, `CHUNK` of them in each pass over the pixels.

    No array of pixels times things exists.

    Args:
        best: of the pixels, before.
        things: pytree of arrays (n, ...).
        padding: one of them that changes nothing, arrays (...).
        meet: `best` after a thing, arrays (...).
        matters: (n,) bool, the things that can change something; None = all. Passes
            over the others are saved.
    """
    if matters is not None:
        first = jnp.argsort(~matters)
        things = jax.tree.map(lambda x: x[first], things)
    count = jax.tree.leaves(things)[0].shape[0]
    missing = -count % CHUNK

    def chunks(x: jax.Array, other: jax.Array) -> jax.Array:
        rest = jnp.broadcast_to(jnp.asarray(other, x.dtype), (missing, *x.shape[1:]))
        return jnp.concatenate([x, rest]).reshape(-1, CHUNK, *x.shape[1:])

    def visit(best: jax.Array, chunk: Tree) -> jax.Array:
        for k in range(CHUNK):
            best = meet(best, jax.tree.map(lambda x: x[k], chunk))  # noqa: B023
        return best

    ready = jax.tree.map(chunks, things, padding)
    if matters is None:
        return jax.lax.scan(lambda *at: (visit(*at), None), best, ready)[0]
    return jax.lax.fori_loop(
        0,
        -(-matters.sum() // CHUNK),
        lambda k, best: visit(best, jax.tree.map(lambda x: x[k], ready)),
        best,
    )
