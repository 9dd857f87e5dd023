"""Proximity rings: how many objects a circle about the car touches, now and before.

Objects are walls, each counted once, discs, movers and, with `RingConfig.cars`, parked
cars and other agents.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, RingConfig
from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.observations.fields import Field
from carpark_mj.observations.sensors import observed
from carpark_mj.obstacles.lot import lot_obstacles
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


def count_rings(config: RingConfig, state: State) -> jax.Array:
    """Counts (num_agents, rings) int32, up to the cap, where agents think they are.

    Every object is tested: no cheaper test than this distance could rule one out.
    """
    motion = observed(state)
    there = lot_obstacles(state.layout, motion, state.parked_cars, state.movers)
    cars = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR)
    seen = [group for group in there if config.cars or group.kind not in cars]
    gaps = [
        jnp.where(group.counts(motion.size.shape[0]), group.gaps(motion.xy), jnp.inf)
        for group in seen
    ]
    gap = jnp.concatenate(gaps, axis=1)
    radii = jnp.array(config.diameters, gap.dtype) / 2
    count = jnp.sum(gap[:, :, None] < radii, axis=1)
    return jnp.minimum(count, config.cap)


def ring_counts(config: RingConfig, state: State) -> dict[str, jax.Array]:
    """Counts now and in the past by their fields' names, (num_agents, 1) each."""
    if not config.diameters:
        return {}
    counts = count_rings(config, state)
    if config.history:
        assert state.ring_history is not None
        past = state.ring_history.reshape(counts.shape[0], -1)
        counts = jnp.concatenate([counts, past], axis=1)
    return {name: counts[:, k : k + 1] for k, name in enumerate(_names(config))}


def init_history(config: EnvConfig) -> jax.Array | None:
    """Past counts (num_agents, history, rings) int32, oldest first: zeros.

    None if the past is not observed.
    """
    rings = config.observation.rings
    if not rings.history:
        return None
    shape = (config.num_agents, rings.history, len(rings.diameters))
    return jnp.zeros(shape, jnp.int32)


def update_history(config: EnvConfig, state: State) -> jax.Array | None:
    """The past once the counts of the state belong to it; see `init_history`."""
    if state.ring_history is None:
        return None
    counts = count_rings(config.observation.rings, state).astype(jnp.int32)
    return jnp.concatenate([state.ring_history[:, 1:], counts[:, None]], axis=1)


def forget(history: jax.Array | None, respawned: jax.Array) -> jax.Array | None:
    """The past with zeros for agents (num_agents,) that start a new episode."""
    if history is None:
        return None
    return jnp.where(respawned[:, None, None], 0, history)


def _names(config: RingConfig) -> list[str]:
    now = [f"ring_{diameter:g}m" for diameter in config.diameters]
    past = range(config.history, 0, -1)
    return now + [f"{name}_ago_{ago}" for ago in past for name in now]
