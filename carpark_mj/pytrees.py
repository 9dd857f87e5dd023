"""States as pytrees: to be donated, and to be saved."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import Tracer

Tree = TypeVar("Tree")


def own_buffers(tree: Tree) -> Tree:
    """The tree in buffers of its own; traced arrays as they are.

    Outside of `jax.jit` functions give arrays on that they were called with, constants
    of an environment among them, and one array in several places. A program that takes
    over its argument (`donate_argnums`) would delete them, or refuse.
    """

    def own(x: jax.Array) -> jax.Array:
        return x if isinstance(x, Tracer) else x.copy()

    return jax.tree.map(own, tree)


def without_empty(tree: Any) -> Any:
    """The tree with None for arrays without elements, which Orbax refuses to save."""
    return jax.tree.map(lambda x: x if x.size else None, tree)


def with_empty(saved: Any, like: Tree) -> Tree:
    """Undoes `without_empty`.

    Args:
        saved: what it gave.
        like: a tree of the arrays' shapes and types, as of `jax.eval_shape`.
    """

    def fill(shape: Any, x: Any) -> Any:
        return x if shape.size else jnp.zeros(shape.shape, shape.dtype)

    return jax.tree.map(fill, like, saved)
