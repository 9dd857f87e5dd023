"""A metric: how hard cars turn."""

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, Metric, register_metric
from carpark_mj.types import Transition


def lateral_acceleration(config: EnvConfig, transition: Transition) -> jax.Array:
    """Yaw rate times speed at the end of a step (num_agents,) [m/s²]."""
    motion = transition.after.motion
    return jnp.abs(motion.yaw_rate * motion.speed)


register_metric(
    Metric(
        name="peak_lateral",
        unit="m/s²",
        meaning="largest lateral acceleration",
        pool="most",
        value=lateral_acceleration,
    )
)
