"""Oriented boxes and discs in the plane: overlap, distance, rays and contact times.

A box is a pose (..., 3), its centre and heading [m, m, rad], with a size (..., 2),
length along the heading and width [m]. A disc is a centre (..., 2) with a radius (...)
[m]. Every function broadcasts over leading dimensions and is exact (no sampling).
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import optimization_barrier

from carpark_mj.geometry.se2 import finite_slope, norm, rotate, sqrt, to_local

# Signs of the four corners in the box frame, counter-clockwise from front left.
_CORNER_SIGNS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
_Two = tuple[jax.Array, jax.Array]  # as x and y, (...) each


def box_corners(pose: jax.Array, size: jax.Array) -> jax.Array:
    """Corners (..., 4, 2) [m] of boxes, counter-clockwise from front left."""
    signs = jnp.array(_CORNER_SIGNS, dtype=pose.dtype)
    local = 0.5 * size[..., None, :] * signs
    return pose[..., None, :2] + rotate(local, pose[..., None, 2])


class _Pair(NamedTuple):
    """How boxes a and b lie to each other; (...) each, of one shape.

    By coordinates, which vectorises on a CPU; so does all that is made of them.
    """

    b_in_a: _Two  # b's centre in a's frame [m]
    a_in_b: _Two  # a's centre in b's frame [m]
    half_a: _Two  # half length and half width [m]
    half_b: _Two
    cos: jax.Array  # of b's heading in a's frame
    sin: jax.Array

    def overlap(self) -> jax.Array:
        """Whether the interiors intersect, see `boxes_overlap`."""
        # Half extents of each box along the other's axes follow from |cos| and |sin| of
        # the heading difference; only the four axes of two boxes can separate them.
        cos, sin = jnp.abs(self.cos), jnp.abs(self.sin)

        def meet(offset: Any, own: Any, other: Any) -> jax.Array:
            """Whether shadows on the axes of `own` overlap."""
            reach_x = own[0] + other[0] * cos + other[1] * sin
            reach_y = own[1] + other[0] * sin + other[1] * cos
            return (jnp.abs(offset[0]) < reach_x) & (jnp.abs(offset[1]) < reach_y)

        return meet(self.b_in_a, self.half_a, self.half_b) & meet(
            self.a_in_b, self.half_b, self.half_a
        )


def _relate(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> _Pair:
    """Boxes as a pair: sines of every box, not of every pair."""

    def columns(pose: jax.Array, size: jax.Array) -> list[jax.Array]:
        x, y, yaw = jnp.unstack(pose, axis=-1)
        return [x, y, jnp.cos(yaw), jnp.sin(yaw), *jnp.unstack(0.5 * size, axis=-1)]

    both = jnp.broadcast_arrays(*columns(pose_a, size_a), *columns(pose_b, size_b))
    x_a, y_a, cos_a, sin_a, *half_a = both[:6]
    x_b, y_b, cos_b, sin_b, *half_b = both[6:]
    x, y = x_b - x_a, y_b - y_a
    return _Pair(
        b_in_a=(cos_a * x + sin_a * y, cos_a * y - sin_a * x),
        a_in_b=(-cos_b * x - sin_b * y, sin_b * x - cos_b * y),
        half_a=(half_a[0], half_a[1]),
        half_b=(half_b[0], half_b[1]),
        cos=cos_a * cos_b + sin_a * sin_b,
        sin=cos_a * sin_b - sin_a * cos_b,
    )


def boxes_overlap(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Whether the interiors of boxes intersect (separating axis theorem).

    Boxes that only touch do not overlap. Any NaN gives False.
    """
    return _relate(pose_a, size_a, pose_b, size_b).overlap()


def box_inside(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Whether box a lies wholly within box b (edges may touch)."""
    offset, reach = _extent(pose_a, size_a, pose_b)
    return jnp.all(jnp.abs(offset) + reach <= 0.5 * size_b, axis=-1)


def box_room(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Room (..., 4) between box a and the edges of b [m], negative if a is beyond.

    Of the edges at +x, -x, +y, -y in the frame of b.
    """
    offset, reach = _extent(pose_a, size_a, pose_b)
    both = 0.5 * size_b - reach
    room = jnp.stack([both - offset, both + offset], axis=-1)
    return room.reshape(*offset.shape[:-1], 4)


def _extent(pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array) -> _Two:
    """Centre of box a in the frame of b, and how far a reaches about it; (..., 2)."""
    local = to_local(pose_b, pose_a)
    cos, sin = jnp.abs(jnp.cos(local[..., 2])), jnp.abs(jnp.sin(local[..., 2]))
    x, y = 0.5 * size_a[..., 0], 0.5 * size_a[..., 1]
    return local[..., :2], jnp.stack([x * cos + y * sin, x * sin + y * cos], axis=-1)


def point_box_distance(point: jax.Array, pose: jax.Array, size: jax.Array) -> jax.Array:
    """Distance [m] from points (..., 2) to boxes; 0 inside."""
    # By coordinates, which vectorises on a CPU.
    box_x, box_y, yaw = jnp.unstack(pose, axis=-1)
    half_x, half_y = jnp.unstack(0.5 * size, axis=-1)
    point_x, point_y = jnp.unstack(point, axis=-1)
    cos, sin, x, y = jnp.broadcast_arrays(
        jnp.cos(yaw), jnp.sin(yaw), point_x - box_x, point_y - box_y
    )
    ahead = jnp.maximum(jnp.abs(cos * x + sin * y) - half_x, 0.0)
    aside = jnp.maximum(jnp.abs(cos * y - sin * x) - half_y, 0.0)
    return sqrt(ahead * ahead + aside * aside)


def box_distance(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Clearance [m] between boxes; 0 where they overlap.

    Two disjoint convex polygons are closest at a vertex of one of them, so the eight
    corner-to-box distances suffice.
    """
    pair = _relate(pose_a, size_a, pose_b, size_b)
    # The frame of a turned as seen from b is that of b turned the other way.
    to_b = _least_gap(pair.a_in_b, pair.half_a, pair.half_b, pair.cos, -pair.sin)
    to_a = _least_gap(pair.b_in_a, pair.half_b, pair.half_a, pair.cos, pair.sin)
    return jnp.where(pair.overlap(), 0.0, sqrt(jnp.minimum(to_a, to_b)))


def _least_gap(
    centre: _Two, half: _Two, own_half: _Two, cos: jax.Array, sin: jax.Array
) -> jax.Array:
    """Squared distance (...) [m^2] from a box to the nearest corner of another.

    The other's centre (x, y) [m] and the cosine and sine of its heading are in the
    box's frame; half lengths and widths [m] are its own and the box's.
    """
    ahead_x, ahead_y = half[0] * cos, half[0] * sin
    left_x, left_y = half[1] * sin, half[1] * cos
    front_x, front_y = centre[0] + ahead_x, centre[1] + ahead_y
    back_x, back_y = centre[0] - ahead_x, centre[1] - ahead_y
    corners = (
        (front_x - left_x, front_y + left_y),
        (back_x - left_x, back_y + left_y),
        (back_x + left_x, back_y - left_y),
        (front_x + left_x, front_y - left_y),
    )
    gaps: list[jax.Array] = []
    for x, y in corners:
        ahead = jnp.maximum(jnp.abs(x) - own_half[0], 0.0)
        aside = jnp.maximum(jnp.abs(y) - own_half[1], 0.0)
        gaps.append(ahead * ahead + aside * aside)
    return functools.reduce(jnp.minimum, gaps)


def box_disc_distance(
    pose: jax.Array, size: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Clearance [m] between boxes and discs (..., 2), (...); 0 where they overlap."""
    return jnp.maximum(point_box_distance(centre, pose, size) - radius, 0.0)


def box_disc_overlap(
    pose: jax.Array, size: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Whether the interiors of boxes and discs intersect; as `boxes_overlap`."""
    return point_box_distance(centre, pose, size) < radius


def box_passes_disc(
    pose: jax.Array, size: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Whether moving boxes meet discs before each of some instants.

    A corner that swings inwards passes thin discs that overlap the box at no instant.
    In the frame of the box discs move straight between instants, and before the first
    with the change of velocity that they have after it.

    Boxes (..., k, 3), (..., 1, 2) and discs (..., k or 1, 2), (..., 1) at k instants
    give (..., k) bool; all false for one instant.
    """
    # Once for a box, not for each of the discs. By coordinates, and corner by corner: a
    # short last axis costs ten times as much on CPUs.
    cos, sin = optimization_barrier((jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])))
    dx, dy = centre[..., 0] - pose[..., 0], centre[..., 1] - pose[..., 1]
    x, y = cos * dx + sin * dy, cos * dy - sin * dx
    if x.shape[-1] == 1:
        return jnp.zeros(x.shape, bool)
    way_x, way_y = ways_to(x), ways_to(y)
    half_x, half_y = 0.5 * size[..., 0], 0.5 * size[..., 1]
    # The middles of discs: slabs, backwards from the end of the way.
    enter_x, leave_x = _slab(x, way_x, half_x)
    enter_y, leave_y = _slab(y, way_y, half_y)
    enter = jnp.maximum(jnp.maximum(enter_x, enter_y), 0.0)
    met = enter < jnp.minimum(jnp.minimum(leave_x, leave_y), 1.0)
    # Their outlines: corners of the box.
    squared = way_x * way_x + way_y * way_y
    squared = jnp.where(squared > 0.0, squared, 1.0)
    for ahead, left in _CORNER_SIGNS:
        to_x, to_y = x - ahead * half_x, y - left * half_y
        back = jnp.clip((to_x * way_x + to_y * way_y) / squared, 0.0, 1.0)
        to_x, to_y = to_x - back * way_x, to_y - back * way_y
        met = met | (to_x * to_x + to_y * to_y < radius * radius)
    return met


def ways_to(there: jax.Array) -> jax.Array:
    """Ways (..., k) to each of k > 1 instants; the first is extrapolated."""
    way = jnp.diff(there, axis=-1)
    first = way[..., :1]
    if way.shape[-1] > 1:
        first = 2.0 * first - way[..., 1:2]
    return jnp.concatenate([first, way], axis=-1)


def _slab(end: jax.Array, way: jax.Array, half: jax.Array) -> _Two:
    """Shares of ways, backwards from their ends, at which they cross a slab."""
    way = jnp.where(jnp.abs(way) < 1e-9, 1e-9, way)
    middle, reach = end / way, jnp.abs(half / way)
    return middle - reach, middle + reach


def ray_box_distance(
    origin: jax.Array, direction: jax.Array, pose: jax.Array, size: jax.Array
) -> jax.Array:
    """Distance (...) [m] along rays to boxes: the slab test.

    Rays start at `origin` (..., 2) [m] along unit vectors (..., 2). 0 from inside, inf
    without a hit; a ray along an edge misses.
    """
    offset = origin - pose[..., :2]
    # Once for a box, not for each of its rays, which XLA would do to save memory.
    cos, sin = optimization_barrier((jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])))

    def along(vector: jax.Array) -> _Two:
        x, y = vector[..., 0], vector[..., 1]
        return cos * x + sin * y, cos * y - sin * x

    def slab(start: jax.Array, speed: jax.Array, size: jax.Array) -> _Two:
        # A ray along a slab gives +-inf, the right ends of its interval; on the edge
        # 0 / 0, and NaN fails the comparison.
        one, other = _time(-0.5 * size - start, speed), _time(0.5 * size - start, speed)
        return jnp.minimum(one, other), jnp.maximum(one, other)

    starts = optimization_barrier(along(offset))
    speeds = along(direction)
    enter_x, leave_x = slab(starts[0], speeds[0], size[..., 0])
    enter_y, leave_y = slab(starts[1], speeds[1], size[..., 1])
    enter, leave = jnp.maximum(enter_x, enter_y), jnp.minimum(leave_x, leave_y)
    hit = (enter <= leave) & (leave >= 0.0)
    return jnp.where(hit, jnp.maximum(enter, 0.0), jnp.inf)


# Along a slab it is infinite, and so are its slopes, though the other slab counts.
_time = finite_slope(lambda distance, speed: distance * (1.0 / speed))


def ray_disc_distance(
    origin: jax.Array, direction: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Distance [m] along rays to discs (..., 2), (...); as `ray_box_distance`."""
    ahead_x, ahead_y = direction[..., 0], direction[..., 1]
    x, y = centre[..., 0] - origin[..., 0], centre[..., 1] - origin[..., 1]
    along = ahead_x * x + ahead_y * y
    aside = ahead_x * y - ahead_y * x
    # From the chord, not from the quadratic formula, which cancels far away.
    chord = sqrt(jnp.maximum(radius**2 - aside**2, 0.0))
    hit = (jnp.abs(aside) < radius) & (along + chord >= 0.0)
    return jnp.where(hit, jnp.maximum(along - chord, 0.0), jnp.inf)


def box_contact_time(
    pose_a: jax.Array,
    size_a: jax.Array,
    pose_b: jax.Array,
    size_b: jax.Array,
    velocity: jax.Array,
) -> jax.Array:
    """Time (...) [s] until box a overlaps box b if it moves straight, without turning.

    The separating axis test for moving convex objects (Ericson, Real-Time Collision
    Detection, 2005, section 5.5.2): they overlap while their shadows on all four axes
    do. `velocity` (..., 2) is that of a as seen from b, world axes [m/s]. 0 where they
    overlap, inf where they never will or only touch.
    """
    local = to_local(pose_a, pose_b)
    turn = local[..., 2]
    cos, sin = jnp.abs(jnp.cos(turn)), jnp.abs(jnp.sin(turn))

    def shadow(half: jax.Array) -> jax.Array:
        along, across = half[..., 0], half[..., 1]
        return jnp.stack([along * cos + across * sin, along * sin + across * cos], -1)

    half_a, half_b = 0.5 * size_a, 0.5 * size_b
    way_a = rotate(velocity, -pose_a[..., 2])
    way_a, way_b = jnp.broadcast_arrays(way_a, rotate(way_a, -turn))
    # Along the axes of a, then along those of b.
    offset = jnp.concatenate([local[..., :2], rotate(local[..., :2], -turn)], axis=-1)
    speed = jnp.concatenate([way_a, way_b], axis=-1)
    reach = jnp.concatenate([half_a + shadow(half_b), half_b + shadow(half_a)], axis=-1)
    # At rest along an axis: +-inf, the right ends; on the edge 0 / 0, and NaN fails
    # the comparison.
    one, other = (offset - reach) / speed, (offset + reach) / speed
    enter = jnp.max(jnp.minimum(one, other), axis=-1)
    leave = jnp.min(jnp.maximum(one, other), axis=-1)
    hit = (enter < leave) & (leave > 0.0)
    return jnp.where(hit, jnp.maximum(enter, 0.0), jnp.inf)


def box_disc_contact_time(
    pose: jax.Array,
    size: jax.Array,
    centre: jax.Array,
    radius: jax.Array,
    velocity: jax.Array,
) -> jax.Array:
    """Time [s] until boxes moving straight overlap discs (..., 2), (...) at rest.

    The disc's centre, seen from the box, runs along a ray against the box grown by the
    radius (Ericson, section 5.5.7): two boxes and a disc at each corner. As
    `box_contact_time` otherwise.
    """
    speed = norm(velocity)
    moving = speed > 0.0
    direction = -velocity / jnp.where(moving, speed, 1.0)[..., None]
    grown = 2.0 * radius[..., None]
    distances = [
        ray_box_distance(centre, direction, pose, size + grown * jnp.array(axis))
        for axis in ((1.0, 0.0), (0.0, 1.0))
    ]
    corners = ray_disc_distance(
        centre[..., None, :],
        direction[..., None, :],
        box_corners(pose, size),
        radius[..., None],
    )
    distance = jnp.minimum(jnp.minimum(*distances), jnp.min(corners, axis=-1))
    time = jnp.where(moving, distance / jnp.where(moving, speed, 1.0), jnp.inf)
    return jnp.where(box_disc_overlap(pose, size, centre, radius), 0.0, time)


def swept_half_size(size: jax.Array, spread: jax.Array) -> jax.Array:
    """Half sizes (..., 2) [m] around boxes that turn by up to `spread` (...) [rad]."""
    # l cos + w sin is largest at atan(w / l) and monotonic up to there.
    half = 0.5 * size
    other = half[..., ::-1]
    turn = jnp.minimum(spread[..., None], jnp.arctan2(other, half))
    return half * jnp.cos(turn) + other * jnp.sin(turn)
