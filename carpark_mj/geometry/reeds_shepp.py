"""Lengths of shortest paths of a car of bounded curvature in both gears.

Words and formulas are those of Reeds and Shepp, *Optimal paths for a car that goes both
forwards and backwards*, Pacific Journal of Mathematics 145 (1990), section 8. A word is
tried in four mirror images (time reversed, sides swapped, both), some also backwards.
"""

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.geometry.se2 import arccos, arcsin, arctan2, sqrt, to_local

_HALF = jnp.pi / 2
# A turn of 0 may come out as this much in the other direction: without it a car that
# has its goal straight ahead would find a word only with turns of 60 degrees and more.
_ROUNDING = 1e-5  # rad, or radii of a straight line
# The mirror images: as is, time reversed, sides swapped, both.
_TIME, _SIDE = np.array([1.0, -1.0, 1.0, -1.0]), np.array([1.0, 1.0, -1.0, -1.0])


def reeds_shepp_length(
    pose: jax.Array, goal: jax.Array, radius: jax.Array
) -> jax.Array:
    """Length (...) [m] of the shortest path from poses (..., 3) to goals (..., 3).

    Both are of the rear axle, `radius` (...) is that of its tightest turn [m].
    """
    x, y, phi = jnp.unstack(to_local(pose, goal), axis=-1)
    x, y, sin, cos = x / radius, y / radius, jnp.sin(phi), jnp.cos(phi)
    # Also backwards, from the goal to the pose; then in four images, (4, 2, ...).
    x, y = jnp.stack([x, x * cos + y * sin]), jnp.stack([y, x * sin - y * cos])
    time, side = (
        jnp.asarray(flip, x.dtype).reshape(4, *[1] * x.ndim) for flip in (_TIME, _SIDE)
    )
    return radius * _lengths(time * x, side * y, time * side * phi).min(axis=(0, 1))


def _lengths(x: jax.Array, y: jax.Array, phi: jax.Array) -> jax.Array:
    """Least lengths (...) of words to goals in units of the radius; inf = no path.

    Every word begins with a turn to the left, then its middle has a length, then comes
    a last turn. Of each the middle is known, and the last turn follows from the first.
    """
    # To the centre of a last turn to the same side, and to the other side.
    sin, cos = jnp.sin(phi), jnp.cos(phi)
    across, up = jnp.stack([x - sin, x + sin]), jnp.stack([y - 1 + cos, y - 1 - cos])
    square = across * across + up * up
    root = sqrt(jnp.maximum(square - 4.0, 0.0))
    same, other = jnp.unstack(arctan2(up, across))
    tilt, other_tilt = jnp.unstack(jnp.arctan2(2.0, root))
    (rho, other_rho), (root, other_root) = jnp.unstack(sqrt(square)), jnp.unstack(root)
    near, far = rho <= 4.0, rho >= 2.0
    apart = other_rho >= 2.0

    third = 2.0 * arcsin(jnp.minimum(rho / 4.0, 1.0))
    share = (2.0 + other_rho) / 4.0
    alike = arccos(jnp.minimum(share, 1.0))
    cusp = (20.0 - other_rho * other_rho) / 16.0
    aside = jnp.clip(cusp, -1.0, 1.0)
    bend = arctan2(2.0 - aside, -sqrt(1.0 - aside * aside))
    # First turn, length of the middle, sense in which the last turn grows with the
    # first, the rest of the last turn, and where there is such a middle.
    words = (
        # (8.1) left, straight, left
        (same, rho, -1, 0.0, True),
        # (8.2) left, straight, right
        (other + other_tilt, other_root, 1, 0.0, apart),
        # (8.3), (8.4) left | right, left
        (same - third / 2 + jnp.pi, third, -1, -third, near),
        # (8.7) left, right | left, right, the two in the middle alike
        (other + alike + _HALF, 2 * alike, -1, 2 * alike, share <= 1.0),
        # (8.8) left | right, left | right
        (other + bend, 2 * arccos(aside), 1, 0.0, (cusp >= 0.0) & (cusp <= 1.0)),
        # (8.9) left | right a quarter, straight, left
        (
            same + tilt + _HALF,
            root + _HALF - 2.0,
            1,
            _HALF,
            far & (root >= 2.0 - _ROUNDING),
        ),
        # (8.10) left | right a quarter, straight, right
        (other + _HALF, other_rho + _HALF - 2.0, -1, -_HALF, apart),
        # (8.11) left | right, straight, left | right, a quarter turn each in the middle
        (
            other + other_tilt + _HALF,
            other_root + jnp.pi - 4.0,
            1,
            0.0,
            apart & (other_root >= 4.0 - _ROUNDING),
        ),
    )
    # One word after the other: stacked ones are computed anew for each of their uses
    # by the CPU programs of the commands (`OUTPUT_FUSION`), ten times as slowly.
    length = jnp.full_like(x, jnp.inf)
    for number, (first, middle, sense, rest, there) in enumerate(words):
        first = _wrap(first)
        last = _wrap(sense * (first - phi) + rest)
        last = jnp.abs(last) if number == 2 else last  # in both gears
        valid = there & (first >= -_ROUNDING) & (last >= -_ROUNDING)
        length = jnp.where(valid, jnp.minimum(length, first + middle + last), length)
    return length


def _wrap(angle: jax.Array) -> jax.Array:
    """Angles in [-pi, pi]; a full half turn keeps its direction."""
    return angle - 2 * jnp.pi * jnp.round(angle / (2 * jnp.pi))
