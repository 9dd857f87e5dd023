"""Gradients where `jax.grad` fails or gives NaN.

The square root of 0 has an infinite slope. Where such a value is masked out, like the
distance of a car to itself, the chain rule gives NaN: 0 times infinity. A loop of
data-dependent length has no gradient in reverse mode.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def with_gradient(
    function: Callable[..., Tree], like: Callable[..., Tree]
) -> Callable[..., Tree]:
    """The function, with the gradients of an equal function."""
    wrapped = jax.custom_jvp(function)
    wrapped.defjvp(lambda args, tangents: jax.jvp(like, args, tangents))
    return wrapped


def finite_slope(function: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """The function with non-finite derivatives replaced by 0.

    `jnp.abs` at 0 is alike. The values are those of the function, bit for bit.

    Args:
        function: elementwise, of arrays that broadcast.
    """

    @jax.custom_jvp
    def wrapped(*args: jax.Array) -> jax.Array:
        return function(*args)

    @wrapped.defjvp
    def _(args: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
        gained = []
        for own, tangent in enumerate(tangents):
            towards = tuple(jnp.full_like(x, i == own) for i, x in enumerate(args))
            slope = jax.jvp(function, args, towards)[1]
            gained.append(jnp.where(jnp.isfinite(slope), slope, 0.0) * tangent)
        return wrapped(*args), sum(gained[1:], gained[0])

    return wrapped


sqrt = finite_slope(jnp.sqrt)
hypot = finite_slope(jnp.hypot)
arctan2 = finite_slope(jnp.arctan2)
arcsin = finite_slope(jnp.arcsin)
arccos = finite_slope(jnp.arccos)
