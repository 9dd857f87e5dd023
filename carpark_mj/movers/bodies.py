"""Bodies that cannot overlap: how far people may go before they touch something.

Of the gap between two people each may use half, so that nobody needs to know how the
other moves. The room towards a convex body is a half-plane: whoever stays within all
of them touches nothing at the end of a step.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.movers.outlines import columns, offsets

SPARE = 1e-3  # m that is left between bodies
TINY = 1e-8  # m², keeps quotients finite where people coincide
STRAIGHT = 0.1  # share of a move aside, below which whoever is stopped goes right


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
    square = x * x + y * y + TINY
    by_distance = jax.lax.rsqrt(square)
    gap = square * by_distance - (radius[:, None] + radius)
    free = jnp.maximum((gap - SPARE) / 2, 0.0)
    return Room(-x * by_distance, -y * by_distance, free)


def room_to(xy: jax.Array, radius: jax.Array, boxes: jax.Array) -> Room:
    """Room of discs (n, 2), (n,) to outlines (6, n or 1, k); any to who is inside."""
    x, y = offsets(xy[:, None], boxes)
    square = x * x + y * y
    by_distance = -jax.lax.rsqrt(square + TINY)
    free = jnp.maximum(jnp.sqrt(square) - radius[:, None] - SPARE, 0.0)
    x, y, cos, sin = x * by_distance, y * by_distance, boxes[2], boxes[3]
    return Room(cos * x - sin * y, sin * x + cos * y, free)


def go_round(rooms: Sequence[Room], move: jax.Array) -> jax.Array:
    """Moves (n, 2) [m] that end within the room, from those that people wish for.

    Whoever is stopped goes aside instead, as far as there is room.
    """
    room = Room(*(jnp.concatenate(part, axis=1) for part in zip(*rooms, strict=True)))
    beyond = room.along(move) - room.free
    worst = beyond.max(axis=1, keepdims=True)
    chosen = (beyond == worst) & (worst > 0.0)
    x = jnp.where(chosen, room.x, 0.0).sum(axis=1)
    y = jnp.where(chosen, room.y, 0.0).sum(axis=1)
    cut = move - jnp.maximum(worst, 0.0) * columns(x, y)
    # Aside they go by what they lose ahead; to the right if they go straight on.
    aside = columns(y, -x)
    lost = jnp.sqrt(jnp.maximum(norm(move) ** 2 - norm(cut) ** 2, 0.0))
    left = (cut * aside).sum(axis=1) < -STRAIGHT * norm(move)
    cut = cut + jnp.where(left, -lost, lost)[:, None] * aside
    along = room.along(cut)
    share = jnp.where(along > room.free, room.free / jnp.maximum(along, TINY), 1.0)
    return cut * share.min(axis=1, keepdims=True)


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
