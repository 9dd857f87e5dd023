"""The layers of one kind of entity, and the maximum over those that are present."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen

EPSILON = 1e-6  # added to variances, as in flax's LayerNorm


class EntityLayers(NamedTuple):
    """Weights of dense layer, normalisation, swish and dense layer.

    Attributes:
        first: kernel (size, features) and bias (features,).
        norm: scale and bias (features,).
        second: kernel (features, features) and bias (features,).
    """

    first: tuple[jax.Array, jax.Array]
    norm: tuple[jax.Array, jax.Array]
    second: tuple[jax.Array, jax.Array]


def encode(layers: EntityLayers, entities: jax.Array) -> jax.Array:
    """Features (..., features) of entities (..., size)."""
    kernel, bias = layers.first
    hidden = entities @ kernel + bias
    centred = hidden - hidden.mean(axis=-1, keepdims=True)
    # A difference of two means, the fast variance, loses digits.
    variance = jnp.square(centred).mean(axis=-1, keepdims=True)
    scale, bias = layers.norm
    hidden = linen.swish(centred * (jax.lax.rsqrt(variance + EPSILON) * scale) + bias)
    kernel, bias = layers.second
    return hidden @ kernel + bias


def largest(layers: EntityLayers, entities: jax.Array, present: jax.Array) -> jax.Array:
    """The largest of each feature over the entities that are present.

    Args:
        layers: of this kind of entity.
        entities: (..., count, size), normalised.
        present: (..., count) bool.

    Returns:
        (..., features); 0 where no entity is present.
    """
    hidden = encode(layers, entities)
    found = jnp.max(jnp.where(present[..., None], hidden, -jnp.inf), axis=-2)
    return jnp.where(present.any(axis=-1, keepdims=True), found, 0.0)
