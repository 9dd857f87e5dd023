"""What changes in the course of a training, and how its environment differs.

Evaluations never see any of it: they run in `PPOConfig.env` as it is.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.curriculum_config import CurriculumConfig

# Progress at which a change begins, and at which it ends.
DISCOUNT_CHANGES = (0.3, 0.8)
SHARE_RISES = (0.2, 0.6)  # [est]; shared from the start, agents learned later


def schedule(start: float, end: float, progress: jax.Array) -> jax.Array:
    """Linear from `start` to `end` as `progress` goes from 0 to 1."""
    return start + (end - start) * jnp.clip(progress, 0.0, 1.0)


def crash_scale(config: CurriculumConfig, progress: jax.Array) -> jax.Array:
    """Factor () on the crash penalty."""
    return schedule(1.0, config.crash_scale, _within(progress, 0, config.crash_until))


def discount(config: PPOConfig, progress: jax.Array) -> jax.Array:
    """Discount factor () per control step."""
    changes = config.curriculum
    if not changes.discount_end:
        return jnp.float32(config.discount)
    start, end = 1 / (1 - config.discount), 1 / (1 - changes.discount_end)
    part = _within(progress, *DISCOUNT_CHANGES)
    return 1.0 - 1.0 / schedule(start, end, part)


def neighbour_share(config: CurriculumConfig, progress: jax.Array) -> jax.Array | None:
    """Weight () of the neighbours' mean advantage; None if there never is any."""
    if not config.neighbour_share:
        return None
    return schedule(0.0, config.neighbour_share, _within(progress, *SHARE_RISES))


def teacher_cost(config: CurriculumConfig, progress: jax.Array) -> jax.Array | None:
    """Weight () of the distance to the teacher's actions; None without a teacher."""
    if not config.teacher:
        return None
    return schedule(
        config.teacher_cost, 0.0, _within(progress, 0, config.teacher_until)
    )


def _within(progress: jax.Array, start: float, end: float) -> jax.Array:
    """Progress () from 0 at `start` to 1 at `end`; a step if they are the same."""
    part = (progress - start) / max(end - start, 1e-6)
    return jnp.where(progress < end, jnp.clip(part, 0.0, 1.0), 1.0)


def training_env(config: PPOConfig) -> EnvConfig:
    """The environment with the starts of the curriculum."""
    names = ("conflict_ratio", "reverse_ratio", "misaligned_ratio")
    asked = {name: getattr(config.curriculum, name) for name in names}
    changes = {name: ratio for name, ratio in asked.items() if ratio}
    spawn = dataclasses.replace(config.env.spawn, **changes)
    return dataclasses.replace(config.env, spawn=spawn)
