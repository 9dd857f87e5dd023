"""Proximity rings: how many objects a circle about the car touches, now and before.

Objects are walls, each counted once, discs, movers and, with `RingConfig.cars`, parked
cars and other agents.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import RingConfig
from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.observations.fields import Field
from carpark_mj.observations.parts import Part, Sight
from carpark_mj.types import State


def ring_fields(config: RingConfig, high: float, where: str) -> list[Field]:
    """The counts as agents observe them: now, then the past, the oldest first.

    Args:
        config: the rings.
        high: largest value.
        where: end of the fields' meaning, the circle and its unit.
    """
    objects = "walls and discs, cars too," if config.cars else "walls and discs"
    meaning = f"{objects} within {where}, capped"
    return [Field(name, 1, 0.0, high, meaning) for name in _names(config)]


def rings_part(config: RingConfig) -> Part:
    """The counts in units of the cap."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        counts = ring_counts(config, sight)
        return {name: count / config.cap for name, count in counts.items()}

    circle = f"the circle about the car [{config.cap}]"
    return Part(tuple(ring_fields(config, 1.0, circle)), fill)


def count_rings(config: RingConfig, sight: Sight) -> jax.Array:
    """Counts (num_observers, rings) int32, up to the cap, about the sensed positions.

    There is no broad phase: the distance is the cheapest test.
    """
    motion = sight.motion
    cars = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR)
    seen = [group for group in sight.obstacles if config.cars or group.kind not in cars]
    gaps = [
        jnp.where(group.counts(motion.size.shape[0]), group.gaps(motion.xy), jnp.inf)
        for group in seen
    ]
    gap = jnp.concatenate(gaps, axis=1)
    radii = jnp.array(config.diameters, gap.dtype) / 2
    count = jnp.sum(gap[:, :, None] < radii, axis=1)
    return jnp.minimum(count, config.cap)


def ring_counts(config: RingConfig, sight: Sight) -> dict[str, jax.Array]:
    """Counts now and in the past by their fields' names, (num_observers, 1) each.

    The past is `State.memory`, see `init_history`.
    """
    if not config.diameters:
        return {}
    counts = count_rings(config, sight)
    if config.history:
        past = sight.state.memory.reshape(counts.shape[0], -1)
        counts = jnp.concatenate([counts, past], axis=1)
    return {name: counts[:, k : k + 1] for k, name in enumerate(_names(config))}


def init_history(config: RingConfig, num_agents: int) -> jax.Array | None:
    """Past counts (num_agents, history, rings) int32, oldest first: zeros.

    None if the past is not observed.
    """
    if not config.history:
        return None
    shape = (num_agents, config.history, len(config.diameters))
    return jnp.zeros(shape, jnp.int32)


def update_history(config: RingConfig, state: State) -> jax.Array | None:
    """The past once the counts of the state belong to it; see `init_history`."""
    if not config.history:
        return None
    counts = count_rings(config, Sight.of(state)).astype(jnp.int32)
    return jnp.concatenate([state.memory[:, 1:], counts[:, None]], axis=1)


def _names(config: RingConfig) -> list[str]:
    now = [f"ring_{diameter:g}m" for diameter in config.diameters]
    past = range(config.history, 0, -1)
    return now + [f"{name}_ago_{ago}" for ago in past for name in now]
