"""Oriented boxes and discs in the plane: overlap, distance, rays and contact times.

A box is a pose (its centre and heading) with a size `(length, width)` [m], length along
the heading. A disc is a centre `(x, y)` with a radius [m]. Every function broadcasts
over leading dimensions and is exact (no sampling).
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry.se2 import norm, rotate, to_local

# Signs of the four corners in the box frame, counter-clockwise from front left.
_CORNER_SIGNS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))


def box_corners(pose: jax.Array, size: jax.Array) -> jax.Array:
    """Corners (..., 4, 2) [m] of boxes, counter-clockwise from front left."""
    signs = jnp.array(_CORNER_SIGNS, dtype=pose.dtype)
    local = 0.5 * size[..., None, :] * signs
    return pose[..., None, :2] + rotate(local, pose[..., None, 2])


def boxes_overlap(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Whether the interiors of oriented boxes intersect (separating axis theorem).

    Args:
        pose_a: (..., 3) centre poses [m, m, rad].
        size_a: (..., 2) length and width [m].
        pose_b: (..., 3) centre poses, broadcastable against `pose_a`.
        size_b: (..., 2) length and width [m].

    Returns:
        (...) bool; boxes that only touch do not overlap. Any NaN gives False.
    """
    # Half extents of each box along the other's axes follow from |cos| and |sin| of
    # the heading difference; the four axes of two rectangles are all that can separate.
    local = to_local(pose_a, pose_b)
    cos, sin = jnp.abs(jnp.cos(local[..., 2])), jnp.abs(jnp.sin(local[..., 2]))
    half_a, half_b = 0.5 * size_a, 0.5 * size_b
    reach_x = half_b[..., 0] * cos + half_b[..., 1] * sin
    reach_y = half_b[..., 0] * sin + half_b[..., 1] * cos
    hit_a = (jnp.abs(local[..., 0]) < half_a[..., 0] + reach_x) & (
        jnp.abs(local[..., 1]) < half_a[..., 1] + reach_y
    )
    offset_b = rotate(local[..., :2], -local[..., 2])
    reach_x = half_a[..., 0] * cos + half_a[..., 1] * sin
    reach_y = half_a[..., 0] * sin + half_a[..., 1] * cos
    hit_b = (jnp.abs(offset_b[..., 0]) < half_b[..., 0] + reach_x) & (
        jnp.abs(offset_b[..., 1]) < half_b[..., 1] + reach_y
    )
    return hit_a & hit_b


def box_inside(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Whether box a lies wholly within box b (edges may touch); shapes as above."""
    local = to_local(pose_b, pose_a)
    cos, sin = jnp.abs(jnp.cos(local[..., 2])), jnp.abs(jnp.sin(local[..., 2]))
    half_a, half_b = 0.5 * size_a, 0.5 * size_b
    reach_x = half_a[..., 0] * cos + half_a[..., 1] * sin
    reach_y = half_a[..., 0] * sin + half_a[..., 1] * cos
    return (jnp.abs(local[..., 0]) + reach_x <= half_b[..., 0]) & (
        jnp.abs(local[..., 1]) + reach_y <= half_b[..., 1]
    )


def point_box_distance(point: jax.Array, pose: jax.Array, size: jax.Array) -> jax.Array:
    """Distance [m] from points (..., 2) to boxes; 0 inside."""
    local = rotate(point - pose[..., :2], -pose[..., 2])
    gap = jnp.maximum(jnp.abs(local) - 0.5 * size, 0.0)
    return norm(gap)


def box_distance(
    pose_a: jax.Array, size_a: jax.Array, pose_b: jax.Array, size_b: jax.Array
) -> jax.Array:
    """Clearance [m] between boxes (..., 3) and (..., 2); 0 where they overlap.

    Two disjoint convex polygons are closest at a vertex of one of them, so the eight
    corner-to-box distances suffice.
    """
    corners_a, corners_b = box_corners(pose_a, size_a), box_corners(pose_b, size_b)
    to_b = point_box_distance(corners_a, pose_b[..., None, :], size_b[..., None, :])
    to_a = point_box_distance(corners_b, pose_a[..., None, :], size_a[..., None, :])
    gap = jnp.minimum(jnp.min(to_b, axis=-1), jnp.min(to_a, axis=-1))
    return jnp.where(boxes_overlap(pose_a, size_a, pose_b, size_b), 0.0, gap)


def box_disc_distance(
    pose: jax.Array, size: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Clearance [m] between boxes and discs (..., 2), (...); 0 where they overlap."""
    return jnp.maximum(point_box_distance(centre, pose, size) - radius, 0.0)


def box_disc_overlap(
    pose: jax.Array, size: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Whether the interiors of boxes (..., 3), (..., 2) and discs intersect.

    Args:
        pose: (..., 3) centre poses of the boxes [m, m, rad].
        size: (..., 2) length and width [m].
        centre: (..., 2) centres of the discs [m].
        radius: (...) radii [m].

    Returns:
        (...) bool; what only touches does not overlap. Any NaN gives False.
    """
    return point_box_distance(centre, pose, size) < radius


def ray_box_distance(
    origin: jax.Array, direction: jax.Array, pose: jax.Array, size: jax.Array
) -> jax.Array:
    """Distance [m] along rays to boxes (..., 3), (..., 2): the slab test.

    Args:
        origin: (..., 2) starts of the rays [m].
        direction: (..., 2) unit vectors.
        pose: (..., 3) centre poses of the boxes [m, m, rad].
        size: (..., 2) length and width [m].

    Returns:
        (...) 0 from inside, inf without a hit; a ray along an edge misses.
    """
    start = rotate(origin - pose[..., :2], -pose[..., 2])
    # A ray along a slab gives +-inf, the right ends of its interval; on the edge 0 / 0,
    # and NaN fails the comparison.
    inverse = 1.0 / rotate(direction, -pose[..., 2])
    half = 0.5 * size
    one, other = (-half - start) * inverse, (half - start) * inverse
    enter = jnp.max(jnp.minimum(one, other), axis=-1)
    leave = jnp.min(jnp.maximum(one, other), axis=-1)
    hit = (enter <= leave) & (leave >= 0.0)
    return jnp.where(hit, jnp.maximum(enter, 0.0), jnp.inf)


def ray_disc_distance(
    origin: jax.Array, direction: jax.Array, centre: jax.Array, radius: jax.Array
) -> jax.Array:
    """Distance [m] along rays to discs (..., 2), (...); as `ray_box_distance`."""
    offset = centre - origin
    along = jnp.sum(direction * offset, axis=-1)
    aside = direction[..., 0] * offset[..., 1] - direction[..., 1] * offset[..., 0]
    # From the chord, not from the quadratic formula, which cancels far away.
    chord = jnp.sqrt(jnp.maximum(radius**2 - aside**2, 0.0))
    hit = (jnp.abs(aside) < radius) & (along + chord >= 0.0)
    return jnp.where(hit, jnp.maximum(along - chord, 0.0), jnp.inf)


def box_contact_time(
    pose_a: jax.Array,
    size_a: jax.Array,
    pose_b: jax.Array,
    size_b: jax.Array,
    velocity: jax.Array,
) -> jax.Array:
    """Time [s] until box a overlaps box b if it moves straight, without turning.

    The separating axis test for moving convex objects (Ericson, Real-Time Collision
    Detection, 2005, section 5.5.2): they overlap while their shadows on all four axes
    do.

    Args:
        pose_a: (..., 3) centre poses [m, m, rad].
        size_a: (..., 2) length and width [m].
        pose_b: (..., 3).
        size_b: (..., 2) [m].
        velocity: (..., 2) of a as seen from b, world axes [m/s].

    Returns:
        (...) 0 where they overlap, inf where they never will or only touch.
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
    ways = [
        ray_box_distance(centre, direction, pose, size + grown * jnp.array(axis))
        for axis in ((1.0, 0.0), (0.0, 1.0))
    ]
    corners = ray_disc_distance(
        centre[..., None, :],
        direction[..., None, :],
        box_corners(pose, size),
        radius[..., None],
    )
    way = jnp.minimum(jnp.minimum(*ways), jnp.min(corners, axis=-1))
    time = jnp.where(moving, way / jnp.where(moving, speed, 1.0), jnp.inf)
    return jnp.where(box_disc_overlap(pose, size, centre, radius), 0.0, time)


def swept_half_size(size: jax.Array, spread: jax.Array) -> jax.Array:
    """Half length and half width (..., 2) [m] that enclose a box of varying heading.

    Args:
        size: (..., 2) length and width of the box [m].
        spread: (...) largest deviation of its heading to either side [rad].
    """
    # l cos + w sin is largest at atan(w / l) and monotonic up to there.
    half = 0.5 * size
    length, width = half[..., 0], half[..., 1]
    along = jnp.minimum(spread, jnp.arctan2(width, length))
    across = jnp.minimum(spread, jnp.arctan2(length, width))
    return jnp.stack(
        [
            length * jnp.cos(along) + width * jnp.sin(along),
            width * jnp.cos(across) + length * jnp.sin(across),
        ],
        axis=-1,
    )
