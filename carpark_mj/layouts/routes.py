"""Routes along the lanes of a lot, around the rows of bays, and their lengths.

A route goes from lane to lane, turning where their centre lines cross, and ends in a
straight line from a lane along which the bay lies. Parked cars and directions of lanes
have no effect. A lot without lanes is open ground: routes are straight lines.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import box_distance, norm, point_box_distance
from carpark_mj.layouts.types import Layout

MAX_TURNS = 6  # from one lane into another; every family needs at most 4
TOUCHING = 0.3  # m, lanes with a smaller gap are joined
PARALLEL = 0.2  # sine of the angle below which lanes lie beside each other: 11.5 deg
INSIDE = 0.1  # m, a car this close to its nearest lane is in it


def lane_distance(layout: Layout, pose_w: jax.Array) -> jax.Array:
    """Distances (num_agents, lanes) of cars (num_agents, 3) [m]; inf for padding."""
    lane = layout.lane_pose, layout.lane_size
    distance = point_box_distance(pose_w[:, None, :2], *lane)
    return jnp.where(layout.lane_mask, distance, jnp.inf)


@struct.dataclass
class Routes:
    """Routes from every lane of a lot to every bay."""

    turns: jax.Array  # (lanes, lanes) bool, whether a car can turn into the other
    crossing: jax.Array  # (lanes, lanes, 2) where centre lines cross [m]
    # (lanes, lanes, bays) length of the route from there to the bay along the second
    # lane [m]; inf where that leads nowhere
    remaining: jax.Array
    beside: jax.Array  # (lanes, bays) bool, whether the bay lies along the lane


class RouteLeft(NamedTuple):
    """Remaining routes of cars (...)."""

    length: jax.Array  # (...) [m]
    next_xy: jax.Array  # (..., 2) where it turns next, at the end the bay's centre [m]


def make_routes(layout: Layout) -> Routes:
    """Finds the shortest routes of one lot (no batch dimension)."""
    pose, size, bays = layout.lane_pose, layout.lane_size, layout.bay_pose
    real = layout.lane_mask & layout.lane_mask[:, None]
    gap = box_distance(pose[:, None], size[:, None], pose, size)
    sine = jnp.sin(pose[:, None, 2] - pose[:, 2])
    joined = real & (gap < TOUCHING)
    parallel = joined & (jnp.abs(sine) < PARALLEL)  # with itself, too
    # From the far lane of an aisle a car turns across the near one.
    across = _any_of(parallel, joined) | _any_of(joined, parallel)
    turns = across & (jnp.abs(sine) >= PARALLEL)
    ahead = jnp.stack([jnp.cos(pose[:, 2]), jnp.sin(pose[:, 2])], axis=-1)
    delta = pose[:, None, :2] - pose[:, :2]  # from the second lane to the first
    # Where centre lines cross, along the first: (delta x second) / sin(first - second).
    cross = delta[..., 0] * ahead[:, 1] - delta[..., 1] * ahead[:, 0]
    along = jnp.where(turns, cross / jnp.where(turns, sine, 1.0), 0.0)
    crossing = pose[:, None, :2] + along[..., None] * ahead[:, None]
    crossing = jnp.where(turns[..., None], crossing, 0.0)

    ahead = jnp.stack([jnp.cos(bays[:, 2]), jnp.sin(bays[:, 2])], axis=-1)
    mouth = bays[:, :2] + 0.5 * layout.bay_size[:, :1] * ahead
    gap = point_box_distance(mouth, pose[:, None], size[:, None])
    gap = jnp.where(layout.lane_mask[:, None], gap, jnp.inf)
    beside = _any_of(parallel, gap <= gap.min(axis=0, initial=jnp.inf) + INSIDE)
    beside = beside & layout.lane_mask[:, None] & layout.bay_mask

    straight = norm(crossing[:, :, None] - bays[:, :2])
    straight = jnp.where(beside, straight, jnp.inf)  # (first, second, bay)
    leg = norm(crossing[:, :, None] - crossing)  # to where the second meets a third
    leg = jnp.where(turns, leg, jnp.inf)

    def turn(_: int, remaining: jax.Array) -> jax.Array:
        onward = jnp.min(leg[..., None] + remaining, axis=2, initial=jnp.inf)
        onward = jnp.minimum(straight, onward)
        return jnp.where(turns[..., None], onward, jnp.inf)

    nowhere = jnp.full(straight.shape, jnp.inf, jnp.float32)
    remaining = jax.lax.fori_loop(0, MAX_TURNS, turn, nowhere)
    return Routes(turns, crossing, remaining, beside)


def route_to(
    routes: Routes | None, layout: Layout, xy: jax.Array, bay: jax.Array
) -> RouteLeft:
    """Remaining routes of cars at `xy` (cars, 2) to bays (cars,); None = straight."""
    goal_xy = layout.bay_pose[bay, :2]
    direct = norm(xy - goal_xy)
    if routes is None or not layout.lane_mask.shape[0]:
        return RouteLeft(direct, goal_xy)
    own = _own_lanes(routes, layout, xy)
    remaining = jnp.moveaxis(routes.remaining[:, :, bay], 2, 0)
    length = norm(xy[:, None, None] - routes.crossing) + remaining
    length = jnp.where(own[:, :, None], length, jnp.inf).reshape(xy.shape[0], -1)
    best = jnp.argmin(length, axis=1)
    around = jnp.take_along_axis(length, best[:, None], axis=1)[:, 0]
    gap = point_box_distance(xy, layout.bay_pose[bay], layout.bay_size[bay])
    arrived = (own & routes.beside[:, bay].T).any(axis=1) | (gap <= INSIDE)
    arrived = arrived | jnp.isinf(around)
    turn_xy = routes.crossing.reshape(-1, 2)[best]
    return RouteLeft(
        jnp.where(arrived, direct, around),
        jnp.where(arrived[:, None], goal_xy, turn_xy),
    )


def _own_lanes(routes: Routes, layout: Layout, xy: jax.Array) -> jax.Array:
    """Lanes (cars, lanes) bool that cars are in: the nearest, and all at a crossing.

    A crossing reaches as far as both lanes are wide. If a car counted as in the first
    lane only until it leaves that lane, its route would grow again behind the crossing.
    """
    gap = lane_distance(layout, xy)
    own = gap <= jnp.min(gap, axis=1, keepdims=True) + INSIDE
    lane, delta = layout.lane_pose, xy[:, None] - layout.lane_pose[:, :2]
    aside = delta[..., 1] * jnp.cos(lane[:, 2]) - delta[..., 0] * jnp.sin(lane[:, 2])
    level = jnp.abs(aside) <= 0.5 * layout.lane_size[:, 1] + INSIDE
    return own | (_any_of(own, routes.turns) & level)


def _any_of(left: jax.Array, right: jax.Array) -> jax.Array:
    """Product of two Boolean matrices (n, k), (k, m)."""
    return (left[:, :, None] & right).any(axis=1)
