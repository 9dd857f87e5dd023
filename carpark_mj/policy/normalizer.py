"""Running statistics of observations, shared by all entities of a kind.

An entity therefore means the same in every slot, and the statistics fit any number of
slots. Padded slots, which a set encoder masks, do not count. Pictures have none.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.training.acme import running_statistics, specs

from carpark_mj.observations.compose import OWN, ObservationSets

# Smallest standard deviation by which observations (scaled to about 1) are divided.
# Numbers that hardly varied in training (sizes in a lot of equal bays) must not swamp
# the network when they do.
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
        observation: (..., size); of its entities those that are present count.
        weight: (...) 0.0 of observations that do not count, else 1.0; None = all 1.
        axis: of devices whose observations are added together.
    """
    parts = sets.split(observation)
    counts: dict[str, jax.Array | None] = {OWN: weight}
    for group, present in sets.present(parts).items():
        of_observer = 1.0 if weight is None else weight[..., None]
        counts[group] = present * of_observer

    def update(name: str, state: Any) -> Any:
        new = running_statistics.update(
            state,
            parts[name],
            weights=counts[name],
            std_min_value=MIN_STD,
            pmap_axis_name=axis,
        )
        # Until the first entity of a kind is seen, its sums are divided by 0.
        count: Any = new.count  # brax's UInt64
        seen = (count.hi | count.lo) > 0
        return jax.tree.map(lambda new, old: jnp.where(seen, new, old), new, state)

    return {name: update(name, state) for name, state in normalizer.items()}


def normalize(
    normalizer: Normalizer, parts: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """Parts of observations, see `ObservationSets.split`, scaled to about unit size.

    Pictures stay as they are.
    """
    scaled = {
        name: running_statistics.normalize(parts[name], state)
        for name, state in normalizer.items()
    }
    return parts | scaled
