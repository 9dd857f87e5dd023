"""The Intelligent Driver Model: how hard a driver accelerates behind another.

Treiber, Hennecke and Helbing 2000, "Congested traffic states in empirical observations
and microscopic simulations", Physical Review E 62, 1805, equations 2 and 3 with
delta = 4:

    a (1 - (v / v0)^4 - (s* / s)^2),  s* = s0 + v T + v dv / (2 sqrt(a b)).
"""

import jax
import jax.numpy as jnp

JAM_GAP = 1.0  # m, s0; 2 m on motorways, shorter at walking pace [est]
BRAKING = 1.67  # m/s², b, table I
NO_GAP = 0.05  # m, below which a gap counts as this


def acceleration(
    speed: jax.Array,
    wanted: jax.Array,
    gap: jax.Array,
    leader_speed: jax.Array,
    headway: jax.Array,
    accel: jax.Array,
) -> jax.Array:
    """Accelerations (...) [m/s²].

    Args:
        speed: v [m/s].
        wanted: v0 [m/s].
        gap: s to who is ahead [m].
        leader_speed: of who is ahead [m/s].
        headway: T [s].
        accel: a [m/s²].
    """
    closing = speed * (speed - leader_speed) / (2.0 * jnp.sqrt(accel * BRAKING))
    desired = JAM_GAP + jnp.maximum(speed * headway + closing, 0.0)
    held = (desired / jnp.maximum(gap, NO_GAP)) ** 2
    return accel * (1.0 - (speed / wanted) ** 4 - held)
