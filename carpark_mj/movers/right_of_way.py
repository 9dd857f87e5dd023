"""Which of two drivers goes first."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import to_local
from carpark_mj.movers.traffic import BACK_OUT, PARK, STAY, Traffic

PATIENCE = 6.0  # s of standing after which who waits longest goes first


def goes_first(traffic: Traffic) -> jax.Array:
    """(n, n) bool, whether the second of a pair goes before the first; one of both.

    Who backs out yields, then who turns into a bay. Otherwise the car from the right
    goes first, and before one that turns left the oncoming. If somebody has waited for
    long, it is who has waited longest; last of all the more aggressive.
    """
    pose, phase = traffic.centre, traffic.phase
    local = to_local(pose[:, None], pose)
    y, turned = local[..., 1], local[..., 2]
    crosses = jnp.abs(jnp.sin(turned)) > 0.5
    from_right = crosses & (y < 0.0) & (y.T > 0.0)
    left = traffic.path.bend > 0.3
    oncoming = (jnp.cos(turned) < -0.7) & left[:, None] & ~left
    rank = jnp.where(phase == PARK, 1, jnp.where(phase == BACK_OUT, 0, 2))
    rank = jnp.where(phase == STAY, -1, rank)
    wait = jnp.where(traffic.clock > PATIENCE, traffic.clock, 0.0)
    order = jnp.arange(rank.shape[0])
    pushes = traffic.aggressiveness
    decisive = (pushes > pushes[:, None]) | (
        (pushes == pushes[:, None]) & (order < order[:, None])
    )

    def more(value: jax.Array, otherwise: jax.Array) -> jax.Array:
        return jnp.where(value == value[:, None], otherwise, value > value[:, None])

    rule = jnp.where(oncoming | oncoming.T, oncoming, decisive)
    rule = jnp.where(from_right | from_right.T, from_right, rule)
    return more(wait, more(rank, rule))
