"""Random numbers of a start, drawn all at once: one call of the generator is one loop.

A start lists the shapes of its uniform numbers in [0, 1) as a tree.
"""

import math
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Draws = TypeVar("Draws")


def draw_uniform(shapes: Draws, key: jax.Array) -> Draws:
    """Independent uniform numbers in [0, 1), arrays in place of their shapes.

    Args:
        shapes: tree (of named tuples) whose leaves are shapes, plain tuples.
        key: consumed.
    """
    leaves, tree = jax.tree.flatten(shapes, is_leaf=_is_shape)
    ends = np.cumsum([math.prod(shape) for shape in leaves])
    numbers = jnp.split(jax.random.uniform(key, (int(ends[-1]),)), ends[:-1])
    parts = [x.reshape(shape) for x, shape in zip(numbers, leaves, strict=True)]
    return jax.tree.unflatten(tree, parts)


def _is_shape(node: Any) -> bool:
    return type(node) is tuple  # not a named tuple


def pick(mask: jax.Array, scores: jax.Array) -> jax.Array:
    """A random index () int32 among those where a mask (n,) is true, if any is.

    Args:
        mask: (n,) bool.
        scores: (n,) uniform numbers in [0, 1), of which the largest wins.
    """
    return jnp.argmax(jnp.where(mask, scores, -1.0)).astype(jnp.int32)


def pick_weighted(weights: jax.Array, number: jax.Array) -> jax.Array:
    """Random indices (...) in proportion to their weights.

    Args:
        weights: (n,) >= 0, not all 0.
        number: (...) uniform in [0, 1).
    """
    ends = jnp.cumsum(weights)
    # 1 - 2**-23 is the largest number drawn, so the product stays below the total.
    return jnp.argmax(number[..., None] * ends[-1] < ends, axis=-1)
