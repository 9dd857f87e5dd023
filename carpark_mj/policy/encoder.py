"""The set encoder: what a network makes of own numbers and of sets of entities.

Late fusion as in GPUDrive (Kazemkhani et al. 2024) and Deep Sets (Zaheer et al. 2017):
all entities of a kind go through the same layers, and the largest of each feature over
the entities that are present goes on. Neither their order nor their number matters.
"""

import jax
import jax.numpy as jnp
from flax import linen

from carpark_mj.observations.fields import ORDERED
from carpark_mj.observations.sets import OWN, ObservationSets


class SetEncoder(linen.Module):
    """Features (..., n) of observations that were split and normalised.

    Attributes:
        sets: parts of the observation.
        own_size: features of the own numbers.
        entity_size: features of an entity, and so of a set.
    """

    sets: ObservationSets
    own_size: int
    entity_size: int

    @linen.compact
    def __call__(
        self, parts: dict[str, jax.Array], present: dict[str, jax.Array]
    ) -> jax.Array:
        """Encodes `parts` of which entities are `present`, see `ObservationSets`."""
        features = [linen.Dense(self.own_size, name=OWN)(parts[OWN])]
        for part in self.sets.sets:
            group, mask = part.group, present[part.group][..., None]
            hidden = linen.Dense(self.entity_size, name=f"{group}_0")(parts[group])
            # The fast variance, a difference of two means, loses digits.
            norm = linen.LayerNorm(use_fast_variance=False, name=f"{group}_norm")
            hidden = linen.swish(norm(hidden))
            hidden = linen.Dense(self.entity_size, name=f"{group}_1")(hidden)
            if group in ORDERED:  # actions name the slots, so all stay apart
                hidden = jnp.where(mask, hidden, 0.0)
                features.append(hidden.reshape(*hidden.shape[:-2], -1))
            else:
                largest = jnp.max(jnp.where(mask, hidden, -jnp.inf), axis=-2)
                features.append(jnp.where(mask.any(axis=-2), largest, 0.0))
        return linen.swish(jnp.concatenate(features, axis=-1))
