"""Buffers of states, which compiled programs may take over."""

from typing import TypeVar

import jax
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
