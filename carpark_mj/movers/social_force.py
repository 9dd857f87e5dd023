"""The social force model of pedestrians: Helbing & Molnár 1995.

"Social force model for pedestrian dynamics", Physical Review E 51, 4282, whose numbers
of equations are given below. Forces are per mass [m/s²].
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.movers.bodies import go_round, room_among
from carpark_mj.movers.outlines import columns, offsets

RELAXATION = 0.5  # s, tau
STRENGTH = 2.1  # m²/s², V0 of people
RANGE = 0.3  # m, sigma of people
BORDER_STRENGTH = 10.0  # m²/s², U0 of borders
BORDER_RANGE = 0.2  # m, R of borders
STEP_TIME = 2.0  # s, Delta t: how far ahead others are taken to step
SIGHT = -0.17364818  # cos of 100°: half the angle of sight
UNSEEN = 0.5  # c, weight of what is behind
SPEED_LIMIT = 1.3  # largest speed over the desired one
SUBSTEP = 0.05  # s, longest
CLOSING = 0.3  # s, in which people use at most half of the gap to who is ahead
TINY = 1e-8  # m², keeps quotients finite where people coincide

Pair = tuple[jax.Array, jax.Array]  # x and y


class Aim(NamedTuple):
    """What people (n,) want.

    Attributes:
        wanted: (n, 2) desired speed times desired direction [m/s].
        heading: (n, 2) desired directions, unit vectors.
        speed: (n,) desired speeds that limit theirs [m/s].
        straight: (n,) bool, on whom no forces act.
        radius: (n,) of their bodies [m].
    """

    wanted: jax.Array
    heading: jax.Array
    speed: jax.Array
    straight: jax.Array
    radius: jax.Array


def walk(
    xy: jax.Array,
    velocity: jax.Array,
    aim: Aim,
    apart: Callable[[jax.Array], Pair],
    borders: Sequence[jax.Array],
    dt: float,
) -> tuple[jax.Array, jax.Array]:
    """Places (n, 2) [m] and velocities (n, 2) [m/s] after a control period.

    It is cut into equal substeps, so that crowds do not depend on it.

    Args:
        xy: (n, 2) before [m].
        velocity: (n, 2) before [m/s].
        aim: what they want in this period.
        apart: x and y (n, n) [m] from the second people to the first, at places.
        borders: `outlines` (6, n or 1, k).
        dt: control period [s].
    """
    steps = max(math.ceil(dt / SUBSTEP - 1e-6), 1)
    share = dt / steps

    def step(_: int, carry: tuple[jax.Array, jax.Array]):
        xy, velocity = carry
        offset = apart(xy)
        fx, fy = push(offset, norm(velocity), aim.heading)
        x, y = fx.sum(axis=1), fy.sum(axis=1)
        for boxes in borders:
            border_x, border_y = border_push(offsets(xy[:, None], boxes))
            cos, sin = boxes[2], boxes[3]
            x = x + (cos * border_x - sin * border_y).sum(axis=1)
            y = y + (sin * border_x + cos * border_y).sum(axis=1)
        force = jnp.where(aim.straight[:, None], 0.0, columns(x, y))
        velocity = advance(velocity, aim.wanted, force, share)
        velocity = limit(velocity, aim.speed)
        room = room_among(offset, aim.radius)
        room = room._replace(free=room.free / CLOSING)
        velocity = go_round([room], velocity)
        return xy + share * velocity, velocity

    return jax.lax.fori_loop(0, steps, step, (xy, velocity))


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
    distance = jnp.sqrt(x * x + y * y + TINY)
    size = jnp.exp(-distance / BORDER_RANGE) / distance
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
