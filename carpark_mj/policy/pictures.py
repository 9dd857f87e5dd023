"""What a network makes of pictures: a small convolutional encoder, one for all views.

Kernels are as long as their strides, so that every convolution is one product of
matrices. The features of the views stay apart: a camera is known by its place.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import linen

# Convolutions: sides of their kernels, and `size` over their channels.
LAYERS = ((4, 2), (2, 1), (2, 1))


class PictureEncoder(linen.Module):
    """Features (..., views * size) of pictures.

    Attributes:
        kinds: of each channel, how many kinds a pixel can show; 0 = it has a number.
        size: features of a view.
        dtype: of all layers.
    """

    kinds: tuple[int, ...]
    size: int
    dtype: Any = jnp.float32

    @linen.compact
    def __call__(self, pictures: jax.Array) -> jax.Array:
        """Encodes pictures (..., views, height, width, channels)."""
        *lead, views, _, _, _ = pictures.shape
        hidden = jnp.concatenate(
            [
                _channels(pictures[..., k], kinds).astype(self.dtype)
                for k, kinds in enumerate(self.kinds)
            ],
            axis=-1,
        )
        for k, (side, share) in enumerate(LAYERS):
            layer = linen.Dense(self.size // share, dtype=self.dtype, name=f"conv_{k}")
            hidden = linen.swish(layer(patches(hidden, side)))
        hidden = hidden.reshape(*lead, views, -1)
        hidden = linen.Dense(self.size, dtype=self.dtype, name="view")(hidden)
        return hidden.reshape(*lead, -1)


def _channels(pixels: jax.Array, kinds: int) -> jax.Array:
    """Numbers (..., 1) of pixels, or whether they show each kind (..., kinds)."""
    pixels = pixels[..., None]
    return pixels == jnp.arange(kinds, dtype=pixels.dtype) if kinds else pixels


def patches(pixels: jax.Array, side: int) -> jax.Array:
    """Squares of pixels (..., height, width, channels) as one pixel each.

    Args:
        pixels: zeros are added at the bottom and on the right to fill the last ones.
        side: of a square.

    Returns:
        (..., rows, columns, side * side * channels).
    """
    *lead, height, width, channels = pixels.shape
    rows, columns = -(-height // side), -(-width // side)
    edges = ((0, rows * side - height), (0, columns * side - width), (0, 0))
    pixels = jnp.pad(pixels, (*((0, 0) for _ in lead), *edges))
    pixels = pixels.reshape(*lead, rows, side, columns, side, channels)
    return jnp.swapaxes(pixels, -4, -3).reshape(*lead, rows, columns, -1)
