"""States as pytrees that can be donated and saved."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import Tracer

Tree = TypeVar("Tree")


def own_buffers(tree: Tree) -> Tree:
    """Copies arrays outside of jit, so that callers may donate them.

    Outside of `jax.jit` a function may return its own arguments, constants of an
    environment, or one array in several places. A program that donates its argument
    (`donate_argnums`) would delete or refuse these.
    """
    return jax.tree.map(lambda x: x if isinstance(x, Tracer) else x.copy(), tree)


def without_empty(tree: Any) -> Any:
    """The tree with None for arrays without elements, which Orbax refuses to save."""
    return jax.tree.map(lambda x: x if x.size else None, tree)


def with_empty(saved: Any, like: Tree) -> Tree:
    """Undoes `without_empty`; `like` has the shapes, as `jax.eval_shape` gives."""

    def fill(shape: Any, x: Any) -> Any:
        return x if shape.size else jnp.zeros(shape.shape, shape.dtype)

    return jax.tree.map(fill, like, saved)
