"""Bodies that cannot overlap: how far people may go before they touch something.

Of the gap between two people each may use half, so that nobody needs to know how the
other moves. The room towards a convex body is a half-plane: whoever stays within all
of them touches nothing at the end of a step.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.movers.outlines import columns, offsets

SPARE = 1e-3  # m that is left between bodies
TINY = 1e-8  # m², keeps quotients finite where people coincide
ROUNDING = 1e-6  # m or m/s, of moves along a body that is touched
STRAIGHT = 0.1  # share of a move aside, below which whoever is stopped goes right

Beyond = tuple[jax.Array, jax.Array, jax.Array]


class Room(NamedTuple):
    """How far people (n,) may go towards bodies (n, k).

    Attributes:
        x: of unit vectors towards them.
        y: of the same.
        free: in these directions [m], at least 0.
    """

    x: jax.Array
    y: jax.Array
    free: jax.Array

    def along(self, move: jax.Array) -> jax.Array:
        """(n, k) how far moves (n, 2) go towards the bodies [m]."""
        return move[:, :1] * self.x + move[:, 1:] * self.y


def room_among(offset: tuple[jax.Array, jax.Array], radius: jax.Array) -> Room:
    """Room of people to each other: half of the gaps.

    Args:
        offset: x and y (n, n) from the second to the first [m]; far for themselves.
        radius: (n,) [m].
    """
    x, y = offset
    distance = jnp.sqrt(x * x + y * y + TINY)
    towards = -1.0 / distance
    gap = distance - (radius[:, None] + radius)
    free = jnp.maximum((gap - SPARE) / 2, 0.0)
    return Room(x * towards, y * towards, free)


def room_to(xy: jax.Array, radius: jax.Array, boxes: jax.Array) -> Room:
    """Room of discs (n, 2), (n,) to outlines (6, n or 1, k); any to who is inside."""
    x, y = offsets(xy[:, None], boxes)
    distance = jnp.sqrt(x * x + y * y + TINY)
    towards = -1.0 / distance
    free = jnp.maximum(distance - radius[:, None] - SPARE, 0.0)
    x, y, cos, sin = x * towards, y * towards, boxes[2], boxes[3]
    return Room(cos * x - sin * y, sin * x + cos * y, free)


def go_round(rooms: Sequence[Room], move: jax.Array) -> jax.Array:
    """Moves (n, 2) [m] that end within the room, from those that people wish for.

    Whoever is stopped goes aside instead, as far as there is room.
    """
    beyond, x, y = functools.reduce(_further, (_nearest(room, move) for room in rooms))
    x, y = jnp.where(beyond > 0.0, x, 0.0), jnp.where(beyond > 0.0, y, 0.0)
    cut = move - jnp.maximum(beyond, 0.0)[:, None] * columns(x, y)
    # Aside they go by what they lose ahead; to the right if they go straight on.
    aside = columns(y, -x)
    lost = jnp.sqrt(jnp.maximum(norm(move) ** 2 - norm(cut) ** 2, 0.0))
    left = (cut * aside).sum(axis=1) < -STRAIGHT * norm(move)
    cut = cut + jnp.where(left, -lost, lost)[:, None] * aside
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
