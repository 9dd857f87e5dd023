"""Ranges of the random quantities of a generator's config, and draws from them."""

import math
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Range

IntRange = tuple[int, int]  # both ends included


def chances(key: jax.Array, count: int) -> jax.Array:
    """(count,) float32 uniform in [0, 1), one for each draw.

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
        low, high = value = getattr(config, name)
        if not (math.isfinite(high) and minimum <= low <= high):
            raise ValueError(
                f"{name} must be a range (low, high) from {minimum:g} up, not {value!r}"
            )
