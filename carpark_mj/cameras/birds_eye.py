"""A lot as seen straight from above each car, which points up in the picture."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.cameras.blocks import Heights, lot_blocks
from carpark_mj.cameras.ground import SHOWS, Place, cover, is_near
from carpark_mj.cameras.hits import fold
from carpark_mj.cameras.rig import BODY, Seen
from carpark_mj.cameras.trace import Seat, seat
from carpark_mj.config.checks import CheckedConfig, Count, Positive
from carpark_mj.layouts.types import LINE_WIDTH
from carpark_mj.types import State

_ANY_HEIGHT = Heights((1.0,), (1.0,))


@dataclasses.dataclass(frozen=True)
class BirdsEye(CheckedConfig):
    """A square picture about the footprint's centre.

    Attributes:
        pixels: of a side.
        span: length of a side [m].
    """

    pixels: Count = 84
    span: Positive = 21.0


def see_from_above(config: BirdsEye, state: State) -> jax.Array:
    """Pictures (num_agents, pixels, pixels) uint8 `Seen`, rows from the front.

    Lines are at least as wide as a pixel.

    Args:
        config: the picture, static.
        state: of one lot.
    """
    boxes, cylinders = lot_blocks(state, _ANY_HEIGHT, of_cars=(BODY,))
    side = config.span * (0.5 - (np.arange(config.pixels) + 0.5) / config.pixels)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    line_width = max(LINE_WIDTH, config.span / config.pixels)
    ahead, left = jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32)
    reach = config.span / math.sqrt(2) + line_width

    def look(agent: jax.Array, goal: jax.Array, pose_w: jax.Array) -> jax.Array:
        place = Place(pose_w[:2], pose_w[2])
        kind = cover(state.layout, goal, place, ahead, left, line_width, reach)
        seen = jnp.array(SHOWS, jnp.int32)[kind]
        for blocks, inside in ((boxes, _in_box), (cylinders, _in_disc)):
            if blocks.low.shape[0]:
                seats = seat(blocks, agent, pose_w, jnp.zeros(3))
                seen = _stand(seen, seats, ahead, left, inside, reach)
        return seen

    agents = jnp.arange(state.goal.shape[0])
    seen = jax.vmap(look)(agents, state.goal, state.motion.pose_w)
    return seen.astype(jnp.uint8).reshape(-1, config.pixels, config.pixels)


def channels(seen: jax.Array, kinds: Sequence[Seen] = tuple(Seen)) -> jax.Array:
    """Pictures (..., height, width, kinds) bool: whether a pixel shows each kind."""
    return seen[..., None] == jnp.array(kinds, seen.dtype)


def _stand(
    seen: jax.Array,
    seats: Seat,
    ahead: jax.Array,
    left: jax.Array,
    inside: Callable[..., jax.Array],
    reach: float,
) -> jax.Array:
    """Pixels (n,) with what stands there; `Seen` has the ground's kinds first."""

    def meet(seen: jax.Array, block: Seat) -> jax.Array:
        x = block.eye[0] + block.cos * ahead + block.sin * left
        y = block.eye[1] + block.cos * left - block.sin * ahead
        return jnp.maximum(seen, jnp.where(inside(block, x, y), block.seen, 0))

    nothing = jax.tree.map(lambda value: jnp.full_like(value[0], -1), seats)
    return fold(
        seen, seats, nothing, meet, is_near(seats.eye[:, :2], seats.half, reach)
    )


def _in_box(box: Seat, x: jax.Array, y: jax.Array) -> jax.Array:
    return (jnp.abs(x) <= box.half[0]) & (jnp.abs(y) <= box.half[1])


def _in_disc(disc: Seat, x: jax.Array, y: jax.Array) -> jax.Array:
    return (x * x + y * y <= disc.half[0] ** 2) & (disc.half[0] > 0.0)
