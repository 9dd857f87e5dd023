"""What rays hit, as whole numbers, and the ground: asphalt, bays, lines, grass."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.cameras.rig import Seen
from carpark_mj.geometry.se2 import norm, rotate
from carpark_mj.layouts import types as paint
from carpark_mj.layouts.types import LINE_WIDTH, Layout

# A hit is a whole number whose order is that of the distance, so that a running minimum
# keeps what is hit, too: the bits of the distance (float32), the last seven of which
# hold the shade and what is seen. That costs 16 um of depth a metre.
SEEN_BITS, SHADE_BITS = 4, 3
SHADES = 2**SHADE_BITS - 1  # the brightest
_LOW = 2 ** (SEEN_BITS + SHADE_BITS) - 1
_INFINITY = 0x7F800000  # its bits
SKY = _INFINITY | (SHADES << SEEN_BITS) | int(Seen.SKY)  # of a ray that meets nothing
MISS = 2**31 - 1  # after all others
CHUNK = 8  # things that a pass over the pixels meets

Tree = TypeVar("Tree")


def encode(
    distance: jax.Array, seen: jax.Array | int, shade: jax.Array | int
) -> jax.Array:
    """Hits of distances [m], at least 0, of what is seen and shades up to `SHADES`."""
    bits = jax.lax.bitcast_convert_type(distance, jnp.int32)
    return (bits & ~_LOW) | (shade << SEEN_BITS) | seen


def decode(hit: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Distances [m], what is seen, and shades."""
    far = hit >= _INFINITY
    middle = (hit & ~_LOW) | (_LOW // 2)  # of what has been cut off
    bits = jnp.where(far, _INFINITY, middle)
    distance = jax.lax.bitcast_convert_type(bits, jnp.float32)
    return distance, hit & (2**SEEN_BITS - 1), (hit >> SEEN_BITS) & SHADES


def fold(
    best: jax.Array,
    things: Tree,
    meet: Callable[[jax.Array, Tree], jax.Array],
    matters: jax.Array | None = None,
) -> jax.Array:
    """Meets things one after the other, `CHUNK` of them in each pass over the pixels.

    No array of pixels times things exists. Things are a pytree of arrays (n, ...); rows
    of -1 pad and change nothing. Passes over those that `matters` (n,) bool excepts,
    which can change nothing, are saved.
    """
    count = jax.tree.leaves(things)[0].shape[0]
    if not count:
        return best
    if matters is not None:
        first = jnp.argsort(~matters)
        things = jax.tree.map(lambda x: x[first], things)

    def chunks(x: jax.Array) -> jax.Array:
        padding = jnp.full((-count % CHUNK, *x.shape[1:]), -1, x.dtype)
        return jnp.concatenate([x, padding]).reshape(-1, CHUNK, *x.shape[1:])

    def visit(best: jax.Array, chunk: Tree) -> jax.Array:
        for k in range(CHUNK):
            best = meet(best, jax.tree.map(lambda x: x[k], chunk))  # noqa: B023
        return best

    ready = jax.tree.map(chunks, things)
    if matters is None:
        return jax.lax.scan(lambda *at: (visit(*at), None), best, ready)[0]
    return jax.lax.fori_loop(
        0,
        -(-matters.sum() // CHUNK),
        lambda k, best: visit(best, jax.tree.map(lambda x: x[k], ready)),
        best,
    )


# Covers of the ground, the upper ones last: what they show, and their heights [m].
ASPHALT, BAY, OWN_BAY, ARROW, LINE, GRASS = range(6)
SHOWS = (Seen.FLOOR, Seen.BAY, Seen.OWN_BAY, Seen.LINE, Seen.LINE, Seen.FLOOR)
HEIGHTS = (0.0, 0.0, 0.0, paint.ARROW_HEIGHT, paint.LINE_HEIGHT, paint.VERGE_HEIGHT)


@struct.dataclass
class Place:
    """A point on a car, about which the ground is looked at."""

    xy_w: jax.Array  # (2,) [m]
    yaw: jax.Array  # () the car's heading [rad]


@struct.dataclass
class Patches:
    """Rectangles (n,) on the ground."""

    xy: jax.Array  # (n, 2) the place in the frame of the rectangle [m]
    cos: jax.Array  # (n,) of the rectangle's heading less the car's
    sin: jax.Array
    half: jax.Array  # (n, 2) half length and width [m], negative where there is none
    cover: jax.Array  # (n,) int32


def cover(
    layout: Layout,
    goal: jax.Array,
    place: Place,
    x: jax.Array,
    y: jax.Array,
    line_width: float = LINE_WIDTH,
    reach: float | None = None,
) -> jax.Array:
    """What covers points x, y (...) ahead and left of a place [m], int32 (...).

    `goal` is the own bay, () int32, `reach` the largest distance of points and lines
    from the place [m]; None = any.
    """
    own = jnp.arange(layout.num_bays) == goal
    kinds = jnp.where(own, OWN_BAY, BAY)
    best = jnp.full(jnp.shape(x), ASPHALT, jnp.int32)
    half = jnp.where(layout.bay_mask[:, None], layout.bay_size / 2, -1.0)
    bays = patches(layout.bay_pose, half, kinds, place)
    best = lay(best, bays, x, y, functools.partial(_in_bay, line_width), reach)
    mask = layout.lane_mask & layout.lane_one_way
    half = jnp.where(mask[:, None], layout.lane_size / 2, -1.0)
    lanes = patches(layout.lane_pose, half, jnp.full(mask.shape, ARROW), place)
    return lay(best, lanes, x, y, _in_arrow, reach)


def is_grass(layout: Layout, place: Place, x: jax.Array, y: jax.Array) -> jax.Array:
    """Whether points lie beyond the asphalt; arguments of `cover`."""
    cos, sin = jnp.cos(place.yaw), jnp.sin(place.yaw)
    x_w = place.xy_w[0] + cos * x - sin * y
    y_w = place.xy_w[1] + sin * x + cos * y
    far = layout.extent + paint.VERGE_GAP
    return (jnp.abs(x_w) > far[0]) | (jnp.abs(y_w) > far[1])


def patches(
    pose: jax.Array, half: jax.Array, covers: jax.Array, place: Place
) -> Patches:
    """Rectangles seen from a place; a negative `half` (n, 2) means there is none."""
    turn = pose[:, 2] - place.yaw
    xy = rotate(place.xy_w - pose[:, :2], -pose[:, 2])
    return Patches(xy, jnp.cos(turn), jnp.sin(turn), half, covers)


def lay(
    best: jax.Array,
    patches: Patches,
    x: jax.Array,
    y: jax.Array,
    fill: Callable[[Patches, jax.Array, jax.Array], jax.Array],
    reach: float | None,
) -> jax.Array:
    """Covers of points (...), the highest number counting; `fill` covers one patch."""

    def meet(best: jax.Array, patch: Patches) -> jax.Array:
        along = patch.xy[0] + patch.cos * x + patch.sin * y
        across = patch.xy[1] + patch.cos * y - patch.sin * x
        found = jnp.where(patch.half[0] > 0.0, fill(patch, along, across), ASPHALT)
        return jnp.maximum(best, found)

    matters = None
    if reach is not None:  # those that come so near to the place
        beyond = jnp.maximum(jnp.abs(patches.xy) - patches.half, 0.0)
        matters = (norm(beyond) < reach) & (patches.half[:, 0] > 0.0)
    return fold(best, patches, meet, matters)


def _in_bay(
    line_width: float, bay: Patches, along: jax.Array, across: jax.Array
) -> jax.Array:
    """A bay has lines about both long sides and within its far end."""
    beyond, aside = jnp.abs(along) - bay.half[0], jnp.abs(across) - bay.half[1]
    inside = jnp.maximum(beyond, aside) <= 0.0
    side = (jnp.abs(aside) <= line_width / 2) & (beyond <= 0.0)
    end = inside & (along + bay.half[0] <= line_width)
    return jnp.where(side | end, LINE, jnp.where(inside, bay.cover, ASPHALT))


def _in_arrow(lane: Patches, along: jax.Array, across: jax.Array) -> jax.Array:
    """A lane has arrows along its middle."""
    length = 2 * lane.half[0]
    count = jnp.maximum(jnp.floor(length / paint.ARROW_SPACING), 1.0)
    number = jnp.clip(jnp.floor((along / length + 0.5) * count), 0.0, count - 1)
    to_tip = ((number + 0.5) / count - 0.5) * length + paint.ARROW_LENGTH / 2 - along
    head = paint.ARROW_HEAD * paint.ARROW_LENGTH
    tip = jnp.clip(to_tip / head, 0.0, 1.0) * paint.ARROW_WIDTH / 2
    wide = jnp.where(to_tip <= head, tip, paint.ARROW_SHAFT * paint.ARROW_WIDTH / 2)
    here = (to_tip > 0.0) & (to_tip <= paint.ARROW_LENGTH)
    return jnp.where(here & (jnp.abs(across) <= wide), lane.cover, ASPHALT)
