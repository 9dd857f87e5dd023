"""The state of a PPO training, and how it lies on the devices."""

from typing import Any

import jax
import numpy as np
from brax.training.types import UInt64
from flax import struct
from jax.sharding import PartitionSpec

AXIS = "lots"


@struct.dataclass
class TrainingState:
    """Everything an exact resume needs.

    Attributes:
        normalizer: running statistics of the observations.
        policy: actor parameters.
        average: their mean over the last updates, the policy that a run leaves.
        value: critic parameters.
        optimizer: Adam's moments, of all parameters as one vector.
        key: randomness of acting and shuffling.
        update: () int32 updates made.
        steps: () agent steps made, of agents that were present.
        skipped: () int32 updates dropped because they were not finite.
        seconds: () float32 of `minutes` used, which the host sets; 0 without them.
        family_rates: (pairs,) running rates of parked episodes by member of a mixture
            and number of agents; (0,) while its lots are not drawn by shortfall.
        env: the Brax state of all lots.
    """

    normalizer: Any
    policy: Any
    average: Any
    value: Any
    optimizer: Any
    key: jax.Array
    update: jax.Array
    steps: UInt64
    skipped: jax.Array
    seconds: jax.Array
    family_rates: jax.Array
    env: Any


def state_specs() -> TrainingState:
    """Lots are divided over the devices, the rest is on all of them."""
    whole: Any = PartitionSpec()
    lots: Any = PartitionSpec(AXIS)
    return TrainingState(
        normalizer=whole,
        policy=whole,
        average=whole,
        value=whole,
        optimizer=whole,
        key=whole,
        update=whole,
        steps=whole,
        skipped=whole,
        seconds=whole,
        family_rates=whole,
        env=lots,
    )


def no_steps() -> UInt64:
    """The count of agent steps before the first; 32 bits would overflow."""
    count: Any = UInt64  # its fields are hidden from Pyright
    return count(0, 0)


def count_steps(state: TrainingState) -> np.ndarray:
    """Agent steps (runs,) int64 that every run has made; of one alone (1,)."""
    return np.ravel(state.steps.to_numpy()).astype(np.int64)
