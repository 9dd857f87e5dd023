"""Full float32 for geometry and physics.

GPUs from Ampere on multiply float32 matrices in TF32 by default, with 10 bits of
mantissa: centimetres at the size of a lot.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")


def is_real(value: object) -> bool:
    """Whether a value is an array of real numbers; truth values are 0 and 1."""
    kinds = jnp.bool_, jnp.integer, jnp.floating
    return isinstance(value, jax.Array | np.ndarray | np.generic) and any(
        jnp.issubdtype(value.dtype, kind) for kind in kinds
    )


def require_float32() -> None:
    """Refuses float64 by default; geometry and physics alone can, as tests do."""
    if jax.config.read("jax_enable_x64"):
        raise ValueError(
            "environments and policies compute in float32: jax_enable_x64 must be "
            "False, not True"
        )


# A decorator: traces a function with matrix products in full float32.
full_float32 = jax.default_matmul_precision("highest")


def float32_only(function: Callable[P, R]) -> Callable[P, R]:
    """As `full_float32`; refuses to run where JAX has been switched to float64."""

    @full_float32
    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        require_float32()
        return function(*args, **kwargs)

    return wrapped
