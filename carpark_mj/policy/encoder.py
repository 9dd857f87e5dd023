"""The set encoder: what a network makes of own numbers, sets of entities and pictures.

Late fusion as in GPUDrive (Kazemkhani et al. 2024) and Deep Sets (Zaheer et al. 2017):
all entities of a kind go through the same layers, and the largest of each feature over
the entities that are present goes on. Neither their order nor their number matters.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import linen

from carpark_mj.observations.compose import OWN, ObservationSets
from carpark_mj.observations.fields import ORDERED
from carpark_mj.policy import entities, entities_kernel
from carpark_mj.policy.entities import EntityLayers
from carpark_mj.policy.pictures import PictureEncoder


class SetEncoder(linen.Module):
    """Features (..., n) of observations that were split and normalised.

    Attributes:
        sets: parts of the observation.
        own_size: features of the own numbers.
        entity_size: features of an entity, and so of a set.
        picture_size: features of a picture, of each view.
        in_kernel: whether sets are encoded in a GPU kernel, see `entities_kernel`.
        dtype: of the layers of own numbers and pictures, and of products in the kernel.
    """

    sets: ObservationSets
    own_size: int
    entity_size: int
    picture_size: int = 0
    in_kernel: bool = False
    dtype: Any = jnp.float32

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
            elif self.in_kernel and entities_kernel.fits(size):
                kernel = entities_kernel.largest
                found = kernel(layers, parts[group], present[group], self.dtype)
            else:
                found = entities.largest(layers, parts[group], present[group])
            features.append(found.astype(own.dtype))
        for part in self.sets.pictures:
            encoder = PictureEncoder(
                part.kinds, self.picture_size, self.dtype, name=part.name
            )
            features.append(encoder(parts[part.name]))
        return linen.swish(jnp.concatenate(features, axis=-1))


class _Layer(linen.Module):
    """Parameters named and initialised as those of flax's `Dense` or `LayerNorm`.

    Attributes:
        shape: of `first`; its last axis is that of the bias.
        first: `kernel` or `scale`.
    """

    shape: tuple[int, ...]
    first: str

    @linen.compact
    def __call__(self) -> tuple[jax.Array, jax.Array]:
        init = linen.initializers
        begin = init.lecun_normal() if self.first == "kernel" else init.ones
        first = self.param(self.first, begin, self.shape)
        return first, self.param("bias", init.zeros, self.shape[-1:])
