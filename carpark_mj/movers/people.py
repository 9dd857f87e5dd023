"""The people of a lot, and the places that they walk to and from."""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import norm, point_box_distance, rotate, to_world
from carpark_mj.geometry.obstacles import Boxes, Discs
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.bodies import group_outlines, meet, outlines

OUTSIDE = 0.6  # m from a bay's line into the aisle: a person and some room
DEPTH = 1.2  # m from there into the gap between two cars
PERSON_ROOM = 0.5  # m about a place that is free
INSET = 1.0  # m from the ends of lanes and the lot's border
GROWN = 0.6  # m by which walls are longer and wider to people that look for a way
ALONG = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of half a lane: where its places are
BORDER = tuple((x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y)
# Sides of a bay in the order in which they are tried: normals.
SIDES = ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-1.0, 0.0))


@struct.dataclass
class Places:
    """Places (n,) of a lot."""

    edge: jax.Array  # (n, 2) in the aisle [m], where walks begin and end
    # (n, 2) between the cars of two bays [m]; of other places the edge
    inner: jax.Array
    mask: jax.Array  # (n,) bool, which of them can be reached
    # (6, m) `outlines` that walks must not meet: bays, and walls grown
    blocks: jax.Array
    walls: jax.Array  # (6, k) of walls and discs


@jax.jit  # traced once for all movers of a lot
def make_places(layout: Layout) -> Places:
    """The places of a lot: one per bay, then of lanes and of the border."""
    bays = outlines(layout.bay_pose, layout.bay_size, layout.bay_mask)
    grown = outlines(layout.wall_pose, layout.wall_size + GROWN, layout.wall_mask)
    blocks = jnp.concatenate([bays, grown], axis=1)
    walls = Boxes(layout.wall_pose, layout.wall_size, mask=layout.wall_mask)
    discs = Discs(layout.disc_centre, layout.disc_radius, mask=layout.disc_mask)
    pose, size = layout.lane_pose, layout.lane_size
    end = jnp.maximum(size[:, :1] / 2 - INSET, 0.0)
    ahead = rotate(jnp.array([1.0, 0.0]), pose[:, 2]) * end
    lane = pose[:, :2] + jnp.array(ALONG)[:, None, None] * ahead
    in_lane = jnp.broadcast_to(layout.lane_mask, lane.shape[:2]).reshape(-1)
    lane = lane.reshape(-1, 2)
    border = jnp.array(BORDER) * (layout.extent - INSET)
    edges, inners = _beside_bays(layout)
    points = jnp.concatenate([edges.reshape(-1, 2), lane, border])
    has_room = _has_room(layout, points)
    ends = edges.shape[0] * edges.shape[1], points.shape[0] - border.shape[0]
    beside, along, at_border = jnp.split(has_room, ends)
    in_lane = in_lane & along
    free = beside.reshape(edges.shape[:2])
    edge, inner, there = _best_sides(layout, edges, inners, free)
    # Some of the border lies behind walls: only what is seen from a bay counts.
    away = norm(border[:, None] - edge)
    bay = jnp.argmin(jnp.where(there, away, jnp.inf), axis=1)
    seen = ~meet(border, edge[bay], blocks) | ~there.any()
    seen = seen & at_border
    return Places(
        jnp.concatenate([edge, lane, border]),
        jnp.concatenate([inner, lane, border]),
        jnp.concatenate([there, in_lane, seen]),
        blocks,
        group_outlines((walls, discs)),
    )


def _beside_bays(layout: Layout) -> tuple[jax.Array, jax.Array]:
    """Edges and inner places (sides, bays, 2) at the sides of bays."""
    normal = jnp.array(SIDES)[:, None]
    tangent = jnp.abs(normal[..., ::-1])
    half = layout.bay_size / 2
    across = jnp.sum(jnp.abs(normal) * half, axis=-1, keepdims=True)
    corner = tangent * half

    def place(depth: jax.Array) -> jax.Array:
        local = normal * depth + corner
        pose = jnp.concatenate([local, jnp.zeros_like(local[..., :1])], axis=-1)
        return to_world(layout.bay_pose, pose)[..., :2]

    inner = across - jnp.minimum(DEPTH - OUTSIDE, across)
    return place(across + OUTSIDE), place(inner)


def _best_sides(
    layout: Layout, edge: jax.Array, inner: jax.Array, free: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Of each bay the places (bays, 2) at one side, and whether there is one."""
    cost = jnp.arange(len(SIDES), dtype=jnp.float32)[:, None] * 0.1
    if layout.lane_mask.shape[0]:
        gap = point_box_distance(edge[:, :, None], layout.lane_pose, layout.lane_size)
        gap = jnp.where(layout.lane_mask, gap, jnp.inf).min(axis=-1)
        cost = cost + jnp.where(layout.lane_mask.any(), gap, 0.0)
    side = jnp.argmin(jnp.where(free, cost, jnp.inf), axis=0)
    bays = jnp.arange(side.shape[0])
    there = free[side, bays] & layout.bay_mask
    edge, inner = edge[side, bays], inner[side, bays]
    # At the end of a row there may be a wall instead of a gap.
    gap = point_box_distance(inner[:, None], layout.wall_pose, layout.wall_size)
    shut = ((gap < PERSON_ROOM) & layout.wall_mask).any(axis=1)
    return edge, jnp.where(shut[:, None], edge, inner), there


def _has_room(layout: Layout, xy: jax.Array) -> jax.Array:
    """(n,) bool, whether there is room for a person at points (n, 2)."""
    free = (jnp.abs(xy) < layout.extent).all(axis=-1)
    pose = jnp.concatenate([layout.bay_pose, layout.wall_pose])
    size = jnp.concatenate([layout.bay_size, layout.wall_size])
    mask = jnp.concatenate([layout.bay_mask, layout.wall_mask])
    gap = point_box_distance(xy[:, None], pose, size)
    free = free & ~((gap < PERSON_ROOM) & mask).any(axis=1)
    gap = norm(xy[:, None] - layout.disc_centre) - layout.disc_radius
    return free & ~((gap < PERSON_ROOM) & layout.disc_mask).any(axis=1)


@struct.dataclass
class People:
    """The people of a lot, (n,)."""

    xy: jax.Array  # (n, 2) [m]
    velocity: jax.Array  # (n, 2) [m/s]
    speed: jax.Array  # desired speed [m/s]
    radius: jax.Array  # [m]
    present: jax.Array  # bool, whether there is such a person
    child: jax.Array  # bool, waits between parked cars and runs across
    stands: jax.Array  # bool, rests for long
    straight: jax.Array  # bool, avoids nobody
    attentive: jax.Array  # bool, gives way to cars
    leader: jax.Array  # int32, leader of the person's group; itself if alone
    offset: jax.Array  # (n, 2) beside the leader's way [m]
    place: jax.Array  # int32, where the walk began
    target: jax.Array  # int32, where it leads
    phase: jax.Array  # int32, of the walk, see `carpark_mj.movers.pedestrians`
    inside: jax.Array  # bool, whether it ends between parked cars
    clock: jax.Array  # time since the phase began; negative = of rest left [s]
    halted: jax.Array  # time without headway, on the way or by a car that waits [s]
    near: jax.Array  # (6, n, k) `outlines` of parked cars and walls that are near
    turn: jax.Array  # () int32, the people that are looked up next
    places: Places  # of the lot
