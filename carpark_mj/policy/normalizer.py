"""Running statistics of observations, one set of numbers for all entities of a kind.

So an entity means the same in every slot, and the statistics fit any number of slots.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme import running_statistics, specs

from carpark_mj.observations.sets import OWN, ObservationSets

# Smallest standard deviation by which observations (scaled to about 1) are divided:
# what hardly varied in training (sizes in a lot of equal bays) must not swamp the
# network where it differs.
MIN_STD = 0.1

Normalizer = dict[str, Any]  # Brax's running statistics by part


def init_normalizer(sets: ObservationSets) -> Normalizer:
    """Statistics at the start of training."""
    sizes = {OWN: sets.own_size, **{part.group: part.size for part in sets.sets}}
    return {name: _init(size) for name, size in sizes.items()}


def _init(size: int) -> Any:
    state = running_statistics.init_state(specs.Array((size,), np.dtype("float32")))
    return jax.tree.map(jnp.asarray, state)


def update_normalizer(
    sets: ObservationSets,
    normalizer: Normalizer,
    observation: jax.Array,
    weight: jax.Array | None = None,
    axis: str | None = None,
) -> Normalizer:
    """Statistics with observations (..., size) added.

    Args:
        sets: parts of the vectors.
        normalizer: before.
        observation: (..., size).
        weight: (...) 0.0 of observations that do not count, else 1.0; None = all 1.
        axis: of devices whose observations are added together.
    """
    parts = sets.split(observation)

    def update(state: Any, part: jax.Array) -> Any:
        weights = weight
        if weights is not None:
            entities = range(weights.ndim, part.ndim - 1)
            weights = jnp.expand_dims(weights, entities)
            weights = jnp.broadcast_to(weights, part.shape[:-1])
        return running_statistics.update(
            state,
            part,
            weights=weights,
            std_min_value=MIN_STD,
            pmap_axis_name=axis,
        )

    return {name: update(state, parts[name]) for name, state in normalizer.items()}


def normalize(
    normalizer: Normalizer, parts: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """Parts of observations, see `ObservationSets.split`, scaled to about unit size."""
    return {
        name: running_statistics.normalize(part, normalizer[name])
        for name, part in parts.items()
    }
