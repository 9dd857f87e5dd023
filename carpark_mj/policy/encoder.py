"""The set encoder: what a network makes of own numbers, sets of entities and pictures.

Late fusion as in GPUDrive (Kazemkhani et al. 2024) and Deep Sets (Zaheer et al. 2017):
all entities of a kind go through the same layers, and the largest of each feature over
the entities that are present goes on. Neither their order nor their number matters.

Pictures go through one small convolutional encoder for all views. Kernels are as long
as their strides, so that every convolution is one product of matrices. The features of
the views stay apart: a camera is known by its place.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import linen

from carpark_mj.observations.compose import OWN, ObservationSets
from carpark_mj.observations.fields import ORDERED
from carpark_mj.policy import entities
from carpark_mj.policy.entities import EntityLayers


class SetEncoder(linen.Module):
    """Features (..., n) of observations that were split and normalised."""

    sets: ObservationSets  # parts of the observation
    own_size: int  # features of the own numbers
    entity_size: int  # features of an entity, and so of a set
    picture_size: int = 0  # features of a picture, of each view
    in_kernel: bool = False  # whether a GPU kernel encodes sets, see `entities`
    dtype: Any = jnp.float32  # of own numbers, pictures, products in the kernel

    @linen.compact
    def __call__(
        self, parts: dict[str, jax.Array], present: dict[str, jax.Array]
    ) -> jax.Array:
        """Encodes `parts` of which entities are `present`, see `ObservationSets`."""
        own = linen.Dense(self.own_size, dtype=self.dtype, name=OWN)(parts[OWN])
        features = [own]
        for part in self.sets.sets:
            group, size = part.group, self.entity_size
            layers = EntityLayers(
                _Layer((part.size, size), "kernel", name=f"{group}_0")(),
                _Layer((size,), "scale", name=f"{group}_norm")(),
                _Layer((size, size), "kernel", name=f"{group}_1")(),
            )
            if group in ORDERED:  # actions name the slots, so all stay apart
                hidden = entities.encode(layers, parts[group])
                hidden = jnp.where(present[group][..., None], hidden, 0.0)
                found = hidden.reshape(*hidden.shape[:-2], -1)
            elif self.in_kernel and entities.fits(size):
                found = entities.largest_in_kernel(
                    layers, parts[group], present[group], self.dtype
                )
            else:
                found = entities.largest(layers, parts[group], present[group])
            features.append(found.astype(own.dtype))
        for part in self.sets.pictures:
            size, name = self.picture_size, part.name
            encoder = PictureEncoder(part.kinds, size, self.dtype, name=name)
            features.append(encoder(parts[name]))
        return linen.swish(jnp.concatenate(features, axis=-1))


class _Layer(linen.Module):
    """Parameters named and initialised as those of flax's `Dense` or `LayerNorm`."""

    shape: tuple[int, ...]  # of `first`; its last axis is that of the bias
    first: str  # `kernel` or `scale`

    @linen.compact
    def __call__(self) -> tuple[jax.Array, jax.Array]:
        init = linen.initializers
        begin = init.lecun_normal() if self.first == "kernel" else init.ones
        first = self.param(self.first, begin, self.shape)
        return first, self.param("bias", init.zeros, self.shape[-1:])


# Convolutions: sides of their kernels, and `size` over their channels.
LAYERS = ((4, 2), (2, 1), (2, 1))


class PictureEncoder(linen.Module):
    """Features (..., views * size) of pictures."""

    kinds: tuple[int, ...]  # of each channel's pixels; 0 = they show a number
    size: int  # features of a view
    dtype: Any = jnp.float32  # of all layers

    @linen.compact
    def __call__(self, pictures: jax.Array) -> jax.Array:
        """Encodes pictures (..., views, height, width, channels)."""
        *lead, views, _, _, _ = pictures.shape
        channels = [_channels(pictures[..., k], n) for k, n in enumerate(self.kinds)]
        hidden = jnp.concatenate([x.astype(self.dtype) for x in channels], axis=-1)
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

    That is (..., rows, columns, side * side * channels). Zeros at the bottom and on the
    right fill the last squares.
    """
    *lead, height, width, channels = pixels.shape
    rows, columns = -(-height // side), -(-width // side)
    edges = ((0, rows * side - height), (0, columns * side - width), (0, 0))
    pixels = jnp.pad(pixels, (*((0, 0) for _ in lead), *edges))
    pixels = pixels.reshape(*lead, rows, side, columns, side, channels)
    return jnp.swapaxes(pixels, -4, -3).reshape(*lead, rows, columns, -1)
