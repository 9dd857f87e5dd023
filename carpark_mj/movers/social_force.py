"""The social force model of pedestrians: Helbing & Molnár 1995.

"Social force model for pedestrian dynamics", Physical Review E 51, 4282, whose numbers
of equations are given below. Forces are per mass [m/s²].
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm

RELAXATION = 0.5  # s, tau
STRENGTH = 2.1  # m²/s², V0 of people
RANGE = 0.3  # m, sigma of people
BORDER_STRENGTH = 10.0  # m²/s², U0 of borders
BORDER_RANGE = 0.2  # m, R of borders
STEP_TIME = 2.0  # s, Delta t: how far ahead others are taken to step
SIGHT = -0.17364818  # cos of 100°: half the angle of sight
UNSEEN = 0.5  # c, weight of what is behind
SPEED_LIMIT = 1.3  # largest speed over the desired one
TINY = 1e-8  # m², keeps quotients finite where people coincide

Pair = tuple[jax.Array, jax.Array]  # x and y


def push(offset: Pair, speed: jax.Array, heading: jax.Array) -> Pair:
    """Forces (n, n) of the second people on the first, equations 3, 4 and 8.

    Args:
        offset: x and y (n, n) from the second to the first [m].
        speed: (n,) [m/s].
        heading: (n, 2) unit vectors in which they want to walk.
    """
    x, y = offset
    stride = speed * STEP_TIME
    ahead_x, ahead_y = x - stride * heading[:, 0], y - stride * heading[:, 1]
    near = jnp.sqrt(x * x + y * y + TINY)
    far = jnp.sqrt(ahead_x * ahead_x + ahead_y * ahead_y + TINY)
    both = near + far
    # Twice the semi-minor axis of the ellipse with foci at the ends of the step.
    axis = jnp.sqrt(jnp.maximum(both * both - stride * stride, TINY))
    # One quotient for three unit vectors: quotients would take most of the time.
    size = 0.5 * STRENGTH / RANGE * both / (axis * near * far)
    size = size * jnp.exp(-0.5 / RANGE * axis)
    fx = size * (x * far + ahead_x * near)
    fy = size * (y * far + ahead_y * near)
    towards = -(heading[:, :1] * fx + heading[:, 1:] * fy)
    behind = towards * towards > SIGHT**2 * (fx * fx + fy * fy)
    weight = jnp.where(behind & (towards < 0.0), UNSEEN, 1.0)
    return weight * fx, weight * fy


def border_push(offset: Pair) -> Pair:
    """Forces of borders on people, equation 5.

    Args:
        offset: x and y (...) from the nearest points of the borders to people [m].
    """
    x, y = offset
    square = x * x + y * y + TINY
    by_distance = jax.lax.rsqrt(square)
    size = jnp.exp(-square * by_distance / BORDER_RANGE) * by_distance
    size = BORDER_STRENGTH / BORDER_RANGE * size
    return size * x, size * y


def advance(
    velocity: jax.Array, wanted: jax.Array, force: jax.Array, dt: float
) -> jax.Array:
    """Velocities (n, 2) [m/s] after a step, equation 2 solved for constant forces.

    Args:
        velocity: (n, 2) before.
        wanted: (n, 2) desired speed times desired direction.
        force: (n, 2) of all others.
        dt: time step [s].
    """
    left = jnp.exp(-dt / RELAXATION)
    return velocity * left + (wanted + RELAXATION * force) * (1.0 - left)


def limit(velocity: jax.Array, speed: jax.Array) -> jax.Array:
    """Velocities (n, 2) of at most `SPEED_LIMIT` desired speeds (n,), equation 10."""
    most = SPEED_LIMIT * speed / jnp.maximum(norm(velocity), 1e-6)
    return velocity * jnp.minimum(most, 1.0)[:, None]
