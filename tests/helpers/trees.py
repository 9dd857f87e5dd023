"""Pytrees compared and cut."""

import jax
import jax.numpy as jnp
import numpy as np


def leaves(tree):
    """The leaves as numpy arrays, keys as their numbers."""
    return [
        np.asarray(
            jax.random.key_data(x)
            if jnp.issubdtype(x.dtype, jax.dtypes.prng_key)
            else x
        )
        for x in jax.tree.leaves(tree)
    ]


def same(a, b):
    """Whether two trees agree bit for bit, NaN included."""
    pairs = list(zip(leaves(a), leaves(b), strict=True))
    assert pairs
    return all(np.array_equal(x, y, equal_nan=x.dtype.kind == "f") for x, y in pairs)


def assert_close(found, expected, **tolerance):
    """Asserts that two trees have the same numbers, leaf by leaf."""
    for a, b in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(a, b, **tolerance)


def agent_of(tree, agent):
    """One agent's part of a tree whose leaves lead with (agents,)."""
    return jax.tree.map(lambda x: x[agent], tree)
