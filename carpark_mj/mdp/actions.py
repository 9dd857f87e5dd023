"""What becomes of actions that are out of range: neutralised, or refused.

Jitted code cannot raise, so `ParkingEnv.step` neutralises and counts them; code that
takes actions from outside JAX refuses them with `check_actions`.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike


@dataclasses.dataclass(frozen=True)
class ActionSpec:
    """What an agent's action consists of: numbers in [-1, 1], then indices.

    Attributes:
        continuous: how many numbers in [-1, 1] come first.
        choices: how many there are to choose from in each branch of indices, which
            follow. An action of indices only is int32, any other float32.
    """

    continuous: int
    choices: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Length of an action."""
        return self.continuous + len(self.choices)

    @property
    def dtype(self) -> Any:
        """Of arrays of actions."""
        return jnp.float32 if self.continuous else jnp.int32

    @property
    def middle(self) -> jax.Array:
        """The middle of every range (size,): zeros, then middle indices."""
        indices = [(n - 1) // 2 for n in self.choices]
        return jnp.array([0] * self.continuous + indices, self.dtype)


def neutralise(action: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Makes actions harmless.

    Args:
        action: (..., k), any numbers.

    Returns:
        Actions (..., k) in [-1, 1], NaN replaced by 0 and the rest clipped, and
        (...) bool, whether anything had to be changed.
    """
    invalid = ~(jnp.abs(action) <= 1.0)
    harmless = jnp.where(jnp.isnan(action), 0.0, jnp.clip(action, -1.0, 1.0))
    return harmless, jnp.any(invalid, axis=-1)


def neutralise_choices(
    choice: jax.Array, choices: tuple[int, ...]
) -> tuple[jax.Array, jax.Array]:
    """Makes indices of choices harmless.

    Args:
        choice: (..., k), any numbers.
        choices: how many there are to choose from in each of the k branches.

    Returns:
        Indices (..., k) int32, the middle one for NaN and the nearest for others that
        are none, and (...) bool, whether anything had to be changed.
    """
    most = jnp.array(choices, jnp.float32) - 1
    value = choice.astype(jnp.float32)
    nearest = jnp.clip(jnp.round(value), 0, most)
    harmless = jnp.where(jnp.isnan(value), most // 2, nearest)
    return harmless.astype(jnp.int32), jnp.any(harmless != value, axis=-1)


def harmless(
    spec: ActionSpec, action: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Takes actions (..., spec.size) apart and makes them harmless.

    Returns:
        The numbers (..., spec.continuous) and the indices (..., choices) int32, see
        `neutralise` and `neutralise_choices`, and (...) bool, whether any was changed.
    """
    numbers, invalid = neutralise(action[..., : spec.continuous])
    indices = action[..., spec.continuous :].astype(jnp.int32)
    if spec.choices:
        indices, wrong = neutralise_choices(
            action[..., spec.continuous :], spec.choices
        )
        invalid = invalid | wrong
    return numbers, indices, invalid


def check_actions(action: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Actions from outside as a float32 array, refused if not in [-1, 1].

    Args:
        action: numbers.
        shape: what its shape must be.

    Raises:
        ValueError: wrong shape, NaN, or a number outside [-1, 1].
    """
    array = np.asarray(action, np.float32)
    if array.shape != shape:
        raise ValueError(f"action must have the shape {shape}, not {array.shape}")
    wrong = ~(np.abs(array) <= 1.0)
    if wrong.any():
        index = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ValueError(f"action{list(index)} must lie in [-1, 1], not {array[index]}")
    return array
