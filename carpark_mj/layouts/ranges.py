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
        value = getattr(config, name)
        # Ranges are part of a config's hash, so no lists.
        if not (isinstance(value, tuple) and len(value) == 2):
            raise ValueError(
                f"{name} must be a tuple (lowest, highest value), not {value!r}"
            )
        low, high = value
        whole = "whole numbers " if _is_whole(config, name) else ""
        kinds = int if whole else (int, float)
        good = all(isinstance(x, kinds) and math.isfinite(x) for x in value)
        if not (good and minimum <= low <= high):
            raise ValueError(
                f"{name} must be a range (low, high) of {whole or 'numbers '}from "
                f"{minimum:g} up, not {value!r}"
            )


def _is_whole(config: Any, name: str) -> bool:
    """Whether the range is declared as one of whole numbers."""
    return config.__dataclass_fields__[name].type in (IntRange, "IntRange")
