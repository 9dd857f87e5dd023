"""Gymnasium's spaces of what one agent observes and does."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import layout_config
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import Field, make_fields
from carpark_mj.precision import is_real


def observation_space(
    config: EnvConfig, fields: Sequence[Field] | None = None
) -> spaces.Box:
    """The vector (size,) of some fields, float32; of all an agent observes by default.

    Bounded by the ranges of the fields, or unbounded where these do not hold: where
    sensors add noise, cars can leave the lot, or `highway` physics has no speed limit
    of a car park.
    """
    if fields is None:
        fields = make_fields(config)
    size = [field.size for field in fields]
    low = np.repeat(np.array([field.low for field in fields], np.float32), size)
    high = np.repeat(np.array([field.high for field in fields], np.float32), size)
    enclosed = layout_config(config.layout).is_enclosed
    if config.sensors.is_on or not enclosed or config.physics == "highway":
        low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
    # Zeros are what absent and finished agents observe.
    return spaces.Box(np.minimum(low, 0.0), np.maximum(high, 0.0), dtype=np.float32)


def action_space(spec: ActionSpec) -> spaces.Space[Any]:
    """The action of an agent.

    A `Box` of numbers in [-1, 1], a `MultiDiscrete` of indices, or a `Tuple` of both.
    """
    numbers = spaces.Box(-1.0, 1.0, (spec.continuous,), np.float32)
    if not spec.choices:
        return numbers
    indices = spaces.MultiDiscrete([*spec.choices], dtype=np.int32)
    return spaces.Tuple((numbers, indices)) if spec.continuous else indices


def flat_action(action: Any, spec: ActionSpec) -> np.ndarray:
    """An element of `action_space` as the vector (size,) that the environment takes.

    Raises:
        AssertionError: another shape, NaN or infinity, or no numbers.
    """
    parts = action if isinstance(action, tuple) else (action,)
    try:
        arrays = [np.asarray(part) for part in parts]
        if not all(map(is_real, arrays)):
            raise TypeError
        flat = np.concatenate(arrays, axis=-1, dtype=np.float32)
    except (TypeError, ValueError):
        raise AssertionError(
            f"an action must be of shape ({spec.size},), not {action!r}"
        ) from None
    if flat.shape != (spec.size,):
        raise AssertionError(
            f"an action must be of shape ({spec.size},), not {flat.shape}"
        )
    if not np.isfinite(flat).all():
        raise AssertionError(f"an action must be finite, not {flat}")
    return flat.astype(spec.dtype)
