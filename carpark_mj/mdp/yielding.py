"""Yielding: who stands while another drives nearby pays less for the time."""

import jax
import jax.numpy as jnp

from carpark_mj.config import REWARD_TERMS, EnvConfig, RewardTerm
from carpark_mj.geometry import norm
from carpark_mj.types import Transition

STANDS = 0.1  # m/s, speed below which a car stands [est]
NEAR = 8.0  # m between centres: two cars and the gap to turn between them [est]


def yielding(config: EnvConfig, transition: Transition) -> jax.Array:
    """Time penalty of the step if the car stands while another drives within 8 m.

    Neither's episode ends with the step. Two cars that stand earn nothing, and nobody
    earns more than the penalty: a weight is at most 1.
    """
    motion = transition.after.motion
    goes_on = transition.before.active & ~transition.events.done
    drives = jnp.abs(motion.speed) >= STANDS
    near = norm(motion.xy[:, None] - motion.xy) <= NEAR
    yields = goes_on & ~drives & (near & goes_on & drives).any(axis=1)
    return yields * (config.reward.time / config.episode.max_steps)


REWARD_TERMS.register("yielding", RewardTerm(yielding, most=1.0))
