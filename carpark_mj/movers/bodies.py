"""Outlines of what people may touch, room between bodies, and the social force model.

Forces follow Helbing & Molnár 1995, "Social force model for pedestrian
dynamics", Physical Review E 51, 4282, whose numbers of equations are given below; they
are per mass [m/s²].

Bodies cannot overlap: of the gap between two people each may use half, whatever the
other does. The room towards a convex body is a half-plane: a person that stays within
all of them touches nothing at the end of a step.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.geometry.obstacles import Group

AWAY = 1e6  # m, where boxes are that do not count
SPARE = 1e-3  # m that is left between bodies
TINY = 1e-8  # m², keeps quotients finite where people coincide
ROUNDING = 1e-6  # m or m/s, of moves along a body that is touched
STRAIGHT = 0.1  # share of a move aside, below which a stopped person goes right
DODGE = 2.0  # m/s² [est], by which a stopped person turns aside
# Of the social force model.
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
CLOSING = 0.3  # s, in which people use at most half of the gap ahead

Pair = tuple[jax.Array, jax.Array]  # x and y
Beyond = tuple[jax.Array, jax.Array, jax.Array]


def outlines(pose: jax.Array, size: jax.Array, mask: jax.Array) -> jax.Array:
    """Boxes (n, 3), (n, 2), (n,) as rows (6, n), as loops over boxes want them.

    X, y, cos, sin, half length and half width.
    """
    x, y, yaw = jnp.unstack(pose, axis=-1)
    half_x, half_y = jnp.unstack(size / 2, axis=-1)
    x, y = jnp.where(mask, x, AWAY), jnp.where(mask, y, AWAY)
    return jnp.stack([x, y, jnp.cos(yaw), jnp.sin(yaw), half_x, half_y])


def group_outlines(groups: Sequence[Group]) -> jax.Array:
    """Outlines (6, n) of groups, of discs as squares."""
    rows = [jnp.zeros((6, 0))]
    for group in groups:
        pose, size, _, there = group.as_boxes
        rows.append(outlines(pose, size, there))
    return jnp.concatenate(rows, axis=1)


def offsets(xy: jax.Array, boxes: jax.Array) -> Pair:
    """From boxes (6, ...) to points (..., 2) [m], in the boxes' frames; 0 inside."""
    x, y, cos, sin, half_x, half_y = jnp.unstack(boxes)
    own_x, own_y = jnp.unstack(xy, axis=-1)
    x, y = own_x - x, own_y - y
    x, y = cos * x + sin * y, cos * y - sin * x
    return x - jnp.clip(x, -half_x, half_x), y - jnp.clip(y, -half_y, half_y)


def meet(start: jax.Array, end: jax.Array, boxes: jax.Array) -> jax.Array:
    """Whether ways between points (n, 2) meet any of the boxes (6, m), (n,) bool."""
    x, y, cos, sin, half_x, half_y = jnp.unstack(boxes)

    def turn(x: jax.Array, y: jax.Array) -> Pair:
        return cos * x + sin * y, cos * y - sin * x

    # Separating axes, by half the way and its middle: no quotients.
    middle, half = (start + end) / 2, (end - start) / 2
    x, y = turn(middle[:, :1] - x, middle[:, 1:] - y)
    way_x, way_y = turn(half[:, :1], half[:, 1:])
    long, wide = jnp.abs(way_x), jnp.abs(way_y)
    meets = (jnp.abs(x) < half_x + long) & (jnp.abs(y) < half_y + wide)
    across = jnp.abs(way_x * y - way_y * x) <= half_x * wide + half_y * long
    return (meets & across).any(axis=1)


def columns(x: jax.Array, y: jax.Array) -> jax.Array:
    """Vectors (n, 2) of x and y (n,): a stack that XLA computes once on a CPU.

    Into `jnp.stack` it fuses all that x and y are made of, which is not vectorised.
    """
    return jnp.where(jnp.arange(2) == 0, x[:, None], y[:, None])


class Room(NamedTuple):
    """How far people (n,) may go towards bodies (n, k)."""

    x: jax.Array  # of unit vectors towards them
    y: jax.Array  # of these vectors
    free: jax.Array  # in these directions [m], at least 0

    def along(self, move: jax.Array) -> jax.Array:
        """(n, k) how far moves (n, 2) go towards the bodies [m]."""
        return move[:, :1] * self.x + move[:, 1:] * self.y


def room_among(offset: Pair, radius: jax.Array) -> Room:
    """Room of people to each other: half of the gaps.

    `offset` (n, n) leads from the second to the first [m]; it is far for themselves.
    """
    x, y = offset
    distance = jnp.sqrt(x * x + y * y + TINY)
    towards = -1.0 / distance
    gap = distance - (radius[:, None] + radius)
    free = jnp.maximum((gap - SPARE) / 2, 0.0)
    return Room(x * towards, y * towards, free)


def room_to(xy: jax.Array, radius: jax.Array, boxes: jax.Array) -> Room:
    """Room of discs (n, 2), (n,) to outlines (6, n or 1, k); unlimited if inside."""
    x, y = offsets(xy[:, None], boxes)
    distance = jnp.sqrt(x * x + y * y + TINY)
    towards = -1.0 / distance
    free = jnp.maximum(distance - radius[:, None] - SPARE, 0.0)
    x, y, cos, sin = x * towards, y * towards, boxes[2], boxes[3]
    return Room(cos * x - sin * y, sin * x + cos * y, free)


def go_round(rooms: Sequence[Room], move: jax.Array, aside: float) -> jax.Array:
    """Moves (n, 2) that end within the room, from the desired ones.

    A stopped person turns aside as far as there is room, by at most `aside`, `DODGE`
    over the time of the move.
    """
    beyond, x, y = functools.reduce(_further, (_nearest(room, move) for room in rooms))
    x, y = jnp.where(beyond > 0.0, x, 0.0), jnp.where(beyond > 0.0, y, 0.0)
    cut = move - jnp.maximum(beyond, 0.0)[:, None] * columns(x, y)
    # Aside they go by what they lose ahead; to the right if they go straight on.
    right = columns(y, -x)
    lost = jnp.sqrt(jnp.maximum(norm(move) ** 2 - norm(cut) ** 2, 0.0))
    lost = jnp.minimum(lost, aside)
    left = (cut * right).sum(axis=1) < -STRAIGHT * norm(move)
    cut = cut + jnp.where(left, -lost, lost)[:, None] * right
    shares = [_share(room, cut) for room in rooms]
    return cut * functools.reduce(jnp.minimum, shares)[:, None]


def _further(a: Beyond, b: Beyond) -> Beyond:
    """The one whose move goes further beyond the room."""
    first = a[0] >= b[0]
    x, y, z = (jnp.where(first, *both) for both in zip(a, b, strict=True))
    return x, y, z


def _nearest(room: Room, move: jax.Array) -> Beyond:
    """How far moves (n, 2) end beyond the room [m], and the body's direction, (n,)."""
    # One reduction of all three, which is faster than one each on a CPU.
    beyond = room.along(move) - room.free, room.x, room.y
    return jax.lax.reduce(beyond, (-jnp.inf, 0.0, 0.0), _further, (1,))


def _share(room: Room, move: jax.Array) -> jax.Array:
    """Shares (n,) of moves (n, 2) that end within the room."""
    along = room.along(move)
    beyond = along > room.free + ROUNDING
    share = jnp.where(beyond, room.free / jnp.maximum(along, TINY), 1.0)
    return share.min(axis=1, initial=1.0)


def is_clear(room: Room, move: jax.Array) -> jax.Array:
    """(n,) bool, whether moves (n, 2) end within the room."""
    return (room.along(move) <= room.free + SPARE / 4).all(axis=1)


def meets(
    xy: jax.Array, move: jax.Array, radius: jax.Array, boxes: jax.Array
) -> jax.Array:
    """(n,) bool, whether moves (n, 2) of discs end in boxes (6, k), and nearer."""
    x, y = offsets((xy + move)[:, None], boxes[:, None])
    after = x * x + y * y
    x, y = offsets(xy[:, None], boxes[:, None])
    return ((after < radius[:, None] ** 2) & (after < x * x + y * y)).any(axis=1)


class Aim(NamedTuple):
    """What people (n,) want."""

    wanted: jax.Array  # (n, 2) desired speed times desired direction [m/s]
    heading: jax.Array  # (n, 2) desired directions, unit vectors
    speed: jax.Array  # (n,) desired speeds that limit theirs [m/s]
    straight: jax.Array  # (n,) bool, people without forces
    radius: jax.Array  # (n,) of their bodies [m]


def advance_people(
    xy: jax.Array,
    velocity: jax.Array,
    aim: Aim,
    apart: Callable[[jax.Array], Pair],
    borders: Sequence[jax.Array],
    dt: float,
) -> tuple[jax.Array, jax.Array]:
    """Places (n, 2) [m] and velocities (n, 2) [m/s] after a control period `dt` [s].

    It is cut into equal substeps, so that crowds do not depend on it. `apart` has x and
    y (n, n) [m] from the second people to the first, at places; `borders` are
    `outlines` (6, n or 1, k).
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
        velocity = accelerate(velocity, aim.wanted, force, share)
        velocity = limit(velocity, aim.speed)
        room = room_among(offset, aim.radius)
        room = room._replace(free=room.free / CLOSING)
        velocity = go_round([room], velocity, DODGE * share)
        return xy + share * velocity, velocity

    return jax.lax.fori_loop(0, steps, step, (xy, velocity))


def push(offset: Pair, speed: jax.Array, heading: jax.Array) -> Pair:
    """Forces (n, n) of the second people on the first, equations 3, 4 and 8.

    By offsets (n, n) from the second to the first [m], speeds (n,) [m/s] and desired
    directions (n, 2).
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
    """Forces of borders, equation 5, at `offsets` (...) of people from them [m]."""
    x, y = offset
    distance = jnp.sqrt(x * x + y * y + TINY)
    size = jnp.exp(-distance / BORDER_RANGE) / distance
    size = BORDER_STRENGTH / BORDER_RANGE * size
    return size * x, size * y


def accelerate(
    velocity: jax.Array, wanted: jax.Array, force: jax.Array, dt: float
) -> jax.Array:
    """Velocities (n, 2) [m/s] after a step, equation 2 solved for constant forces."""
    left = jnp.exp(-dt / RELAXATION)
    return velocity * left + (wanted + RELAXATION * force) * (1.0 - left)


def limit(velocity: jax.Array, speed: jax.Array) -> jax.Array:
    """Velocities (n, 2) of at most `SPEED_LIMIT` desired speeds (n,), equation 10."""
    most = SPEED_LIMIT * speed / jnp.maximum(norm(velocity), 1e-6)
    return velocity * jnp.minimum(most, 1.0)[:, None]
