"""A reward term: agents pay for what they drive faster than walking pace."""

import jax
import jax.numpy as jnp

from carpark_mj.config import REWARD_TERMS, EnvConfig, RewardTerm
from carpark_mj.types import Transition


def haste(config: EnvConfig, transition: Transition, above: float = 1.5) -> jax.Array:
    """Penalty for every m/s above a speed [m/s], in every step."""
    return jnp.maximum(jnp.abs(transition.after.motion.speed) - above, 0.0)


REWARD_TERMS.register("haste", RewardTerm(haste, sign=-1))
