"""Lengths of shortest paths of a car of bounded curvature in both gears.

Words and formulas are those of Reeds and Shepp, *Optimal paths for a car that goes both
forwards and backwards*, Pacific Journal of Mathematics 145 (1990), section 8. A word is
tried in four mirror images (time reversed, sides swapped, both), some also backwards.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry.se2 import (
    arccos,
    arcsin,
    arctan2,
    hypot,
    sqrt,
    to_local,
    wrap_angle,
)

_HALF = jnp.pi / 2
# A turn of 0 may come out as this much in the other direction: without it a car that
# has its goal straight ahead would find a word only with turns of 60 degrees and more.
_ROUNDING = 1e-5  # rad, or radii of a straight line


def reeds_shepp_length(
    pose: jax.Array, goal: jax.Array, radius: jax.Array
) -> jax.Array:
    """Length (...) [m] of the shortest path from poses (..., 3) to goals (..., 3).

    Args:
        pose: of the rear axle [m, m, rad].
        goal: as `pose`.
        radius: (...) of the tightest turn of the rear axle [m].
    """
    local = to_local(pose, goal)
    x, y, phi = local[..., 0] / radius, local[..., 1] / radius, local[..., 2]
    # Four images on a new last axis: as is, time reversed, sides swapped, both.
    x = jnp.stack([x, -x, x, -x], axis=-1)
    y = jnp.stack([y, y, -y, -y], axis=-1)
    phi = jnp.stack([phi, -phi, -phi, phi], axis=-1)
    sin, cos = jnp.sin(phi), jnp.cos(phi)
    back_x, back_y = x * cos + y * sin, x * sin - y * cos
    lengths = [
        *_symmetric_words(x, y, phi),
        *_words(x, y, phi),
        *_words(back_x, back_y, phi),
    ]
    return radius * jnp.stack(lengths).min(axis=(0, -1))


def _symmetric_words(x: jax.Array, y: jax.Array, phi: jax.Array) -> list[jax.Array]:
    """Lengths of words that read backwards are words of the same kind."""
    sin, cos = jnp.sin(phi), jnp.cos(phi)
    same = x - sin, y - 1.0 + cos  # to the centre of a last turn to the same side
    other = x + sin, y - 1.0 - cos  # to the other side

    # (8.1) left, straight, left
    u, t = _polar(*same)
    v = wrap_angle(phi - t)
    lsl = _if((t >= -_ROUNDING) & (v >= -_ROUNDING), t + u + v)
    # (8.2) left, straight, right
    rho, angle = _polar(*other)
    u = _root(rho**2 - 4.0)
    t = wrap_angle(angle + jnp.arctan2(2.0, u))
    v = wrap_angle(t - phi)
    lsr = _if((rho >= 2.0) & (t >= -_ROUNDING) & (v >= -_ROUNDING), t + u + v)
    # (8.7) left, right | left, right, the two in the middle alike
    share = (2.0 + rho) / 4.0
    u = _arccos(share)
    t, v = _ends(u, -u, *other, phi)
    lrlr = _if((share <= 1.0) & (t >= -_ROUNDING) & (v <= _ROUNDING), t + 2 * u - v)
    # (8.8) left | right, left | right
    share = (20.0 - rho**2) / 16.0
    u = -_arccos(share)
    t, v = _ends(u, u, *other, phi)
    valid = (share >= 0.0) & (share <= 1.0) & (t >= -_ROUNDING) & (v >= -_ROUNDING)
    cusped = _if(valid, t - 2 * u + v)
    # (8.11) left | right, straight, left | right, a quarter turn each in the middle
    xi, eta = other
    u = 4.0 - _root(rho**2 - 4.0)
    t = arctan2((4.0 - u) * xi - 2.0 * eta, -2.0 * xi + (u - 4.0) * eta)
    v = wrap_angle(t - phi)
    valid = (rho >= 2.0) & (u <= _ROUNDING) & (t >= -_ROUNDING) & (v >= -_ROUNDING)
    quarters = _if(valid, t + jnp.pi - u + v)
    return [lsl, lsr, lrlr, cusped, quarters]


def _words(x: jax.Array, y: jax.Array, phi: jax.Array) -> list[jax.Array]:
    """Lengths of words that must be tried from both ends."""
    sin, cos = jnp.sin(phi), jnp.cos(phi)
    # (8.3), (8.4) left | right, left
    rho, angle = _polar(x - sin, y - 1.0 + cos)
    u = -2.0 * arcsin(jnp.clip(rho / 4.0, 0.0, 1.0))
    t = wrap_angle(angle + u / 2 + jnp.pi)
    v = wrap_angle(phi - t + u)
    lrl = _if((rho <= 4.0) & (t >= -_ROUNDING), t - u + jnp.abs(v))
    # (8.9) left | right a quarter, straight, left
    r = _root(rho**2 - 4.0)
    u = 2.0 - r
    t = wrap_angle(angle + jnp.arctan2(r, -2.0))
    v = wrap_angle(phi - _HALF - t)
    valid = (rho >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING)
    lrsl = _if(valid, t + _HALF - u - v)
    # (8.10) left | right a quarter, straight, right
    rho, t = _polar(-(y - 1.0 - cos), x + sin)
    u = 2.0 - rho
    v = wrap_angle(t + _HALF - phi)
    valid = (rho >= 2.0) & (t >= -_ROUNDING) & (u <= _ROUNDING) & (v <= _ROUNDING)
    lrsr = _if(valid, t + _HALF - u - v)
    return [lrl, lrsl, lrsr]


def _ends(
    u: jax.Array, v: jax.Array, xi: jax.Array, eta: jax.Array, phi: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """First and last turn about two turns u and v in the middle, (8.7) and (8.8)."""
    delta = wrap_angle(u - v)
    a = jnp.sin(u) - jnp.sin(delta)
    b = jnp.cos(u) - jnp.cos(delta) - 1.0
    angle = arctan2(eta * a - xi * b, xi * a + eta * b)
    turned = 2.0 * (jnp.cos(delta) - jnp.cos(v) - jnp.cos(u)) + 3.0 < 0
    t = wrap_angle(angle + jnp.where(turned, jnp.pi, 0.0))
    return t, wrap_angle(t - u + v - phi)


def _polar(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    return hypot(x, y), arctan2(y, x)


def _root(x: jax.Array) -> jax.Array:
    return sqrt(jnp.maximum(x, 0.0))


def _arccos(x: jax.Array) -> jax.Array:
    return arccos(jnp.clip(x, -1.0, 1.0))


def _if(valid: jax.Array, length: jax.Array) -> jax.Array:
    return jnp.where(valid, length, jnp.inf)
