"""Full float32 for geometry and physics.

GPUs from Ampere on multiply float32 matrices in TF32 by default, with 10 bits of
mantissa: centimetres at the size of a lot.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax

P = ParamSpec("P")
R = TypeVar("R")


def require_float32() -> None:
    """Refuses to go on where JAX computes in float64 by default.

    Geometry and physics can, on their own; tests compare with float64.

    Raises:
        ValueError: naming the setting.
    """
    if jax.config.read("jax_enable_x64"):
        raise ValueError(
            "environments and policies compute in float32: jax_enable_x64 must be "
            "False, not True"
        )


def full_float32(function: Callable[P, R]) -> Callable[P, R]:
    """Traces the function with matrix products in full float32."""

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return wrapped
