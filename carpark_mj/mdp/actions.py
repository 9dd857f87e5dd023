"""Actions: their parts, and how invalid numbers are sanitized.

Jitted code cannot raise, so NaN and numbers out of range are replaced and counted.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig


@dataclasses.dataclass(frozen=True)
class ActionSpec:
    """Parts of an agent's action; of indices only it is int32, any other float32.

    Attributes:
        continuous: number of continuous entries, in [-1, 1], which come first.
        choices: number of choices of each index that follows.
    """

    continuous: int
    choices: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Length of an action."""
        return self.continuous + len(self.choices)

    @property
    def dtype(self) -> Any:
        """Dtype of arrays of actions."""
        return jnp.float32 if self.continuous else jnp.int32

    @property
    def middle(self) -> jax.Array:
        """The middle of every range (size,): zeros, then middle indices."""
        indices = [(n - 1) // 2 for n in self.choices]
        return jnp.array([0] * self.continuous + indices, self.dtype)


class Action(NamedTuple):
    """A sanitized action of agents (...)."""

    # (..., k) of the back end: steer and pedal in [-1, 1]; int32 if all are indices
    controls: jax.Array
    # (...) int32 0 = explore, k = head for the k-th tracked bay; None = fixed goals
    goal_choice: jax.Array | None
    invalid: jax.Array  # (...) bool, whether any part was replaced


# [est] Steering to 1/5 of its limit and the pedal to 1/3, both with a zero.
STEERS, PEDALS = 11, 7


def action_table(spec: ActionSpec) -> np.ndarray:
    """Actions (number, spec.size): steering x pedal x choices, the last fastest."""
    numbers = [np.linspace(-1.0, 1.0, n) for n in (STEERS, PEDALS)[: spec.continuous]]
    indices = [np.arange(n) for n in spec.choices]
    return np.array(list(itertools.product(*numbers, *indices)), spec.dtype)


def action_spec(config: EnvConfig) -> ActionSpec:
    """Parts of an action: controls and, with dynamic goals, a choice."""
    goals, physics = config.goals, config.physics_config
    choice = (1 + goals.num_tracked_bays,) if goals.dynamic else ()
    return ActionSpec(physics.continuous, (*physics.choices, *choice))


def parse(config: EnvConfig, action: jax.Array) -> Action:
    """Sanitizes actions (..., size) and takes them apart."""
    spec, choice = action_spec(config), None
    controls, invalid = sanitize_numbers(action[..., : spec.continuous])
    if spec.choices:
        indices, wrong = sanitize_indices(action[..., spec.continuous :], spec.choices)
        invalid = invalid | wrong
        if config.goals.dynamic:
            indices, choice = indices[..., :-1], indices[..., -1]
        if not spec.continuous:
            controls = indices
        elif indices.shape[-1]:
            controls = jnp.concatenate([controls, indices], axis=-1)
    return Action(controls, choice, invalid)


def sanitize_numbers(numbers: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Numbers (..., k) in [-1, 1], NaN as 0, and (...) bool, whether any changed."""
    invalid = ~(jnp.abs(numbers) <= 1.0)
    sanitized = jnp.where(jnp.isnan(numbers), 0.0, jnp.clip(numbers, -1.0, 1.0))
    return sanitized, jnp.any(invalid, axis=-1)


def sanitize_indices(
    indices: jax.Array, choices: tuple[int, ...]
) -> tuple[jax.Array, jax.Array]:
    """Indices (..., k) int32 within `choices`, and (...) bool, whether any was not.

    NaN becomes the middle one, any other invalid number the nearest.
    """
    most = jnp.array(choices, jnp.float32) - 1
    value = indices.astype(jnp.float32)
    nearest = jnp.clip(jnp.round(value), 0, most)
    sanitized = jnp.where(jnp.isnan(value), most // 2, nearest)
    return sanitized.astype(jnp.int32), jnp.any(sanitized != value, axis=-1)
