"""Four high-level actions, SMARTS's for lane following.

With one lane per direction there is no lane to change to: actions are target speeds,
and the two lane changes are one and the same.
"""

import jax
import jax.numpy as jnp

ACTIONS = ("keep_lane", "slow_down", "change_lane_left", "change_lane_right")
TARGET_SPEEDS = (15.0, 0.0, 12.5, 12.5)  # m/s
KEEP_LANE, SLOW_DOWN = 0, 1


def target_speeds(action: jax.Array) -> jax.Array:
    """Target speeds (...) [m/s] of actions (...) int; what is none slows down."""
    known = (action >= 0) & (action < len(ACTIONS))
    speeds = jnp.array(TARGET_SPEEDS)
    return jnp.where(known, speeds[jnp.where(known, action, 0)], 0.0)
