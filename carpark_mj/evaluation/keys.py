"""Disjoint keys of trainings and evaluations with the same seed."""

import jax


def training_key(seed: int) -> jax.Array:
    """The key from which a training draws everything."""
    return jax.random.fold_in(jax.random.key(seed), 0)


def evaluation_key(seed: int) -> jax.Array:
    """The key of an evaluation.

    Random layouts also come from the `test` split (`carpark_mj.layouts.registry`).
    """
    return jax.random.fold_in(jax.random.key(seed), 1)
