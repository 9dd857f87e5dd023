"""Four high-level actions, SMARTS's for lane following.

With one lane per direction there is no lane to change to: actions are target speeds,
and the two lane changes are one and the same.
"""

import jax
import jax.numpy as jnp

from carpark_mj.mdp.actions import ActionSpec, sanitize_indices, sanitize_numbers

ACTIONS = ("keep_lane", "slow_down", "change_lane_left", "change_lane_right")
TARGET_SPEEDS = (15.0, 0.0, 12.5, 12.5)  # m/s
KEEP_LANE, SLOW_DOWN = 0, 1
INDEX, SCALAR = ActionSpec(0, (len(ACTIONS),)), ActionSpec(1)
# Where scalars pass from one action to the next: the study's MADDPG.
EDGES = (-0.5, 0.0, 0.5)


def parse(spec: ActionSpec, action: jax.Array) -> jax.Array:
    """Indices (n,) int32 of the actions that agents ask for.

    Args:
        spec: `INDEX` or `SCALAR`.
        action: (n,) or (n, 1); what is NaN or out of range is sanitized as everywhere.
    """
    action = action.reshape(-1, 1)
    if spec == INDEX:
        return sanitize_indices(action, spec.choices)[0][:, 0]
    numbers = sanitize_numbers(action)[0]
    return (numbers >= jnp.array(EDGES)).sum(axis=-1, dtype=jnp.int32)


def target_speeds(action: jax.Array) -> jax.Array:
    """Target speeds (...) [m/s] of actions (...) int."""
    return jnp.array(TARGET_SPEEDS)[action]
