"""Disjoint keys of trainings and evaluations with the same seed."""

import numbers

import jax

MAX_SEED = 2**32 - 1  # what a key takes; others would be taken modulo 2**32


def require_seed(seed: int) -> None:
    """Refuses an impossible seed of a key.

    Raises:
        ValueError: it is negative, too large, or not a whole number.
    """
    if type(seed) is bool or not isinstance(seed, numbers.Integral):
        raise ValueError(f"seed must be a whole number, not {seed!r}")
    if not 0 <= seed <= MAX_SEED:
        raise ValueError(f"seed must lie in [0, {MAX_SEED}], not {seed}")


def training_key(seed: int) -> jax.Array:
    """The key from which a training draws everything."""
    return jax.random.fold_in(jax.random.key(seed), 0)


def evaluation_key(seed: int) -> jax.Array:
    """The key of an evaluation.

    Random layouts also come from the `test` split (`carpark_mj.layouts.registry`).
    """
    return jax.random.fold_in(jax.random.key(seed), 1)
