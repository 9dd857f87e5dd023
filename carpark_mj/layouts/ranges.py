"""Ranges: what a generator's config leaves to chance, and how it is drawn."""

import math
from typing import Any

import jax
import jax.numpy as jnp

Range = tuple[float, float]  # lowest and highest value; equal = fixed
IntRange = tuple[int, int]  # both ends included


def chances(key: jax.Array, count: int) -> jax.Array:
    """(count,) float32 in [0, 1), to be spent on one draw each.

    One call of the generator for a whole lot: each call costs compilation time.
    """
    return jax.random.uniform(key, (count,), jnp.float32)


def draw(chance: jax.Array, bounds: Range) -> jax.Array:
    """A float32 () uniform over a range."""
    low, high = bounds
    return low + (high - low) * chance


def draw_int(chance: jax.Array, bounds: IntRange) -> jax.Array:
    """An int32 () uniform over a range, both ends included."""
    low, high = bounds
    step = jnp.floor((high - low + 1) * chance).astype(jnp.int32)
    return jnp.minimum(low + step, high)


def require_ranges(config: Any, minimum: float, *names: str) -> None:
    """Refuses ranges of a config that are empty, not finite or reach below a minimum.

    Raises:
        ValueError: naming the first bad range.
    """
    for name in names:
        value = getattr(config, name)
        if len(value) != 2:
            raise ValueError(
                f"{name} must be a lowest and a highest value, not {value}"
            )
        low, high = value
        if not (math.isfinite(low) and math.isfinite(high) and minimum <= low <= high):
            raise ValueError(
                f"{name} must be a range (low, high) from {minimum:g} up, not {value}"
            )


def require_at_least(config: Any, minimum: float, *names: str) -> None:
    """Refuses numbers of a config that are not finite or below a minimum.

    Raises:
        ValueError: naming the first bad number.
    """
    for name in names:
        value = getattr(config, name)
        if not (math.isfinite(value) and value >= minimum):
            raise ValueError(f"{name} must be at least {minimum:g}, not {value}")
