"""Collisions: the obstacles that each agent touched during a step, and near ones.

Physics with contacts reports them. Otherwise, and with movers in any case, footprints
are tested for overlap at every traced instant, and in between with discs, which may be
thin; in crowded lots near pairs only.

Kerbs and wheel stops are low obstacles that wheels may touch slowly, if
`EpisodeConfig.kerb_speed` is set. The body passes over them; the rectangle about the
tyres, as wide as a kerb's height allows them to come, does not. A car that touches one
slowly is stopped dead before it, a faster one has crashed into a wall.

Safety is measured by gaps, times to collision, acceleration and jerk.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.geometry import (
    box_distance,
    move_forward,
    norm,
    point_box_distance,
    rotate,
)
from carpark_mj.geometry.boxes import ways_to
from carpark_mj.geometry.obstacles import (
    MARGIN,
    Boxes,
    Group,
    Merged,
    ObstacleKind,
    by_shape,
    is_crowded,
    joined,
    least_near,
    merge,
    take,
    visit_near,
)
from carpark_mj.geometry.se2 import with_gradient
from carpark_mj.layouts.types import Layout, WallKind
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import Motion, State, Transition

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig, EpisodeConfig

HITS_CHUNK = 3  # pairs per agent tested at a time for overlap: few are near

RANGE = 20.0  # m, largest clearance reported
HORIZON = 10.0  # s, longest time to collision reported
NEAREST_CHUNK = 2  # pairs per agent computed at a time: the nearest is among the first

KERB_HEIGHT = 0.1  # m, of kerbs and wheel stops
STOP_DEPTH = 0.15  # m
STOP_INSET = 0.3  # m, from the lines on either side of its bay
TYRE_WIDTH = 0.2  # m [est]
PARALLEL = 2.4  # length over width of a bay from which it is parallel to its lane


def find_hits(
    state: State, hitbox_scale: jax.Array | float = 1.0
) -> dict[str, jax.Array]:
    """What agents touched in the step that led to a state, (num_agents,) bool by kind.

    By the labels of `ObstacleKind`; in a collision of two agents both are hit.
    `hitbox_scale` () multiplies all cars' sizes, except in physics with contacts.
    """
    motion, parked_cars, movers = state.motion, state.parked_cars, state.movers
    hits: dict[ObstacleKind, jax.Array] = {}
    if motion.touched is not None:
        always = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR, ObstacleKind.WALL)
        kinds = {*always, *(group.kind for group in movers.groups)}
        columns = jnp.moveaxis(motion.touched, -1, 0)
        hits = {k: columns[k] for k in sorted(kinds) if k < columns.shape[0]}
        obstacles = movers.groups
    else:
        motion = dataclasses.replace(motion, size=motion.size * hitbox_scale)
        size = parked_cars.size * hitbox_scale
        parked_cars = dataclasses.replace(parked_cars, size=size)
        obstacles = lot_obstacles(state.layout, motion, parked_cars, movers)
    num_agents = motion.size.shape[0]
    for same in by_shape(obstacles):
        if is_crowded(num_agents, sum(group.count for group in same)):
            found = _near_hits(motion, merge(same, num_agents))
        else:
            found = _all_hits(motion, same)
        for kind, hit in found:
            hits[kind] = hits[kind] | hit if kind in hits else hit
    return {kind.label: hit for kind, hit in hits.items()}


def _all_hits(
    motion: Motion, groups: Sequence[Group]
) -> list[tuple[ObstacleKind, jax.Array]]:
    """Agents (num_agents,) bool that hit any of each group of a shape, by kind."""
    own, own_size = motion.trace_w[:, None], motion.size[:, None, None]
    traced = [group.traced for group in groups]
    hits: dict[int, jax.Array] = {}
    for instants in {there.pose_w.shape[1] for there in traced}:
        # What stands still is tested as it stands.
        rows = [k for k, x in enumerate(traced) if x.pose_w.shape[1] == instants]
        them, _ = joined([traced[k] for k in rows], 1)
        hit = them.hit(own, own_size).any(axis=2)
        ends = np.cumsum([traced[k].count for k in rows])[:-1]
        for k, part in zip(rows, jnp.split(hit, ends, axis=1), strict=True):
            counts = groups[k].counts(motion.size.shape[0])
            hits[k] = (part & counts).any(axis=1)
    return [(group.kind, hits[k]) for k, group in enumerate(groups)]


def _near_hits(motion: Motion, them: Merged) -> list[tuple[ObstacleKind, jax.Array]]:
    """Like `_all_hits`, for the near ones of many obstacles of a shape, by kind."""
    trace, traced = motion.trace_w, them.group.traced
    bound = them.group.gaps(trace[:, -1, :2]) - them.excursion
    bound = jnp.where(them.counts, bound, jnp.inf)
    reach = trace_radius(motion)
    kinds, column = np.unique(them.kind, return_inverse=True)

    def test(hit: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        own_size = motion.size[:, None, None]
        hits = take(traced, index).hit(trace[:, None], own_size)
        found = hits.any(axis=-1) & valid
        of_kind = jnp.asarray(column)[index][..., None] == jnp.arange(len(kinds))
        return hit | jnp.any(found[..., None] & of_kind, axis=1)

    nothing = jnp.zeros((trace.shape[0], len(kinds)), bool)
    hits = visit_near(bound, lambda _: reach, test, nothing, HITS_CHUNK)
    return [(ObstacleKind(kind), hits[:, k]) for k, kind in enumerate(kinds)]


def trace_radius(motion: Motion) -> jax.Array:
    """Radii (num_agents,) [m] of circles about final centres that hold all traces.

    And the way to the first instant, which `box_passes_disc` extrapolates.
    """
    xy = jnp.moveaxis(motion.trace_w[..., :2], 1, -1)
    if xy.shape[-1] > 1:
        xy = jnp.concatenate([xy[..., :1] - ways_to(xy)[..., :1], xy], axis=-1)
    offset = jnp.moveaxis(xy - xy[..., -1:], -1, 1)
    return norm(motion.size) / 2 + norm(offset).max(axis=1) + MARGIN


def find_hits_and_kerbs(config: EpisodeConfig, state: State) -> dict[str, jax.Array]:
    """`find_hits` with kerbs that only wheels touch; stopped cars no longer do."""
    kerb = state.layout.wall_kind == WallKind.KERB
    walls = dataclasses.replace(state.layout, wall_mask=state.layout.wall_mask & ~kerb)
    hits = find_hits(dataclasses.replace(state, layout=walls), config.hitbox_scale)
    touched = touches_kerb(config, state, state.motion.trace_w).any(axis=1)
    name = ObstacleKind.WALL.label
    return hits | {name: hits[name] | touched}


def kerb_stops(
    config: EnvConfig, state: State, motion: Motion
) -> tuple[jax.Array, jax.Array]:
    """Cars that a kerb stops in a step, (num_agents,) bool: they touch one slowly.

    `state` is at the start of the step, `motion` at its end as if there were no kerbs.
    Their traces (num_agents, k, 3) end at the last instant before they touch.
    """
    trace_w = motion.trace_w
    count = trace_w.shape[1]
    touched = touches_kerb(config.episode, state, trace_w)
    first = jnp.argmax(touched, axis=1)[:, None]
    earlier = jnp.concatenate([state.motion.pose_w[:, None], trace_w[:, :-1]], axis=1)
    speed = norm((trace_w - earlier)[..., :2]) * (count / config.sim.ctrl_dt)
    slow = jnp.take_along_axis(speed, first, 1)[:, 0] <= config.episode.kerb_speed
    held = jnp.take_along_axis(earlier, first[..., None], axis=1)
    after = (jnp.arange(count) >= first)[..., None]
    return touched.any(axis=1) & slow, jnp.where(after, held, trace_w)


def touches_kerb(config: EpisodeConfig, state: State, trace_w: jax.Array) -> jax.Array:
    """(num_agents, k) bool, whose wheels touch a kerb at poses (num_agents, k, 3)."""
    obstacles = low_obstacles(config, state.layout)
    pose, size = wheel_boxes(state, trace_w)
    overlap = obstacles.overlap(pose[:, :, None], size[:, None, None])
    return (overlap & obstacles.counts(len(trace_w))[:, None]).any(-1)


def low_obstacles(config: EpisodeConfig, layout: Layout) -> Boxes:
    """Kerbs of a lot, and the wheel stops of its bays that are not parallel ones."""
    kerb = layout.wall_mask & (layout.wall_kind == WallKind.KERB)
    kerbs = layout.wall_pose, layout.wall_size, kerb
    if not config.wheel_stops:
        return Boxes(*kerbs[:2], mask=kerb, kind=ObstacleKind.WALL)
    length, width = layout.bay_size[..., 0], layout.bay_size[..., 1]
    to_centre = length / 2 - config.wheel_stops + STOP_DEPTH / 2
    stops = (
        move_forward(layout.bay_pose, -to_centre),
        jnp.stack([jnp.full_like(width, STOP_DEPTH), width - 2 * STOP_INSET], -1),
        layout.bay_mask & (length < PARALLEL * width),
    )
    pose, size, mask = map(jnp.concatenate, zip(kerbs, stops, strict=True))
    return Boxes(pose, size, mask=mask, kind=ObstacleKind.WALL)


def wheel_boxes(state: State, pose_w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Rectangles about the tyres, at the height of a kerb, of cars at poses.

    Poses (num_agents, ..., 3) are of centres; returns poses and sizes (num_agents, 2).
    """
    car = state.physics.vehicle
    # A wheel of radius r touches an edge at height h this far ahead of its hub.
    reach = jnp.sqrt(2 * car.wheel_radius * KERB_HEIGHT - KERB_HEIGHT**2)
    ahead = car.wheelbase / 2 - car.centre_offset
    ahead = jnp.expand_dims(ahead, range(1, pose_w.ndim - 1))
    size = jnp.stack([car.wheelbase + 2 * reach, car.track_width + TYRE_WIDTH], -1)
    return move_forward(pose_w, ahead), size


def agent_clearance(motion: Motion) -> jax.Array:
    """Gap (num_agents,) [m] to the nearest other agent, as they stand; inf if alone."""
    count = motion.size.shape[0]
    find = _near_agent_gap if is_crowded(count, count) else _agent_gap
    return find(motion.pose_w, motion.size)


def _agent_gap(pose: jax.Array, size: jax.Array) -> jax.Array:
    """`agent_clearance` from all pairs."""
    own = jnp.eye(pose.shape[0], dtype=bool)
    gap = box_distance(pose[:, None], size[:, None], pose, size)
    return jnp.min(jnp.where(own, jnp.inf, gap), axis=0)


@functools.partial(with_gradient, like=_agent_gap)
def _near_agent_gap(pose: jax.Array, size: jax.Array) -> jax.Array:
    """`agent_clearance` from near pairs."""
    own = jnp.eye(pose.shape[0], dtype=bool)

    def find(index: jax.Array) -> jax.Array:
        return box_distance(pose[:, None], size[:, None], pose[index], size[index])

    reach = norm(size) / 2
    bound = point_box_distance(pose[:, None, :2], pose, size) - reach[:, None]
    return least_near(jnp.where(own, jnp.inf, bound), find, jnp.inf, NEAREST_CHUNK)


def _least_by_kind(
    obstacles: Sequence[Group], find: Callable[[Group], jax.Array]
) -> dict[str, jax.Array]:
    """The least of the numbers (num_agents,) of groups, by the kinds' labels."""
    least: dict[str, jax.Array] = {}
    for group in obstacles:
        label, found = group.kind.label, find(group)
        least[label] = jnp.minimum(least[label], found) if label in least else found
    return least


def clearances(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Gaps (num_agents,) [m] of the step by the labels of `ObstacleKind`.

    The smallest gap at the traced instants, where collisions are tested: 0 if
    footprints overlapped at one of them. At most `RANGE`.
    """

    def clearance(group: Group) -> jax.Array:
        own, traced = motion.trace_w, group.traced
        bound = group.gaps(own[:, -1, :2]) - group.excursion
        bound = bound - trace_radius(motion)[:, None]

        def find(index: jax.Array) -> jax.Array:
            own_size = motion.size[:, None, None]
            return take(traced, index).distance(own[:, None], own_size).min(axis=-1)

        bound = jnp.where(group.counts(motion.size.shape[0]), bound, jnp.inf)
        return least_near(bound, find, RANGE, NEAREST_CHUNK)

    return _least_by_kind(obstacles, clearance)


def collision_times(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Times to collision (num_agents,) [s] by the labels of `ObstacleKind`.

    0 where footprints overlap, at most `HORIZON`. The definition is Hayward's (1972,
    "Near-miss determination through use of a scale of danger"): the time until two cars
    collide "if they continue at their present speed and on the same path". Here every
    car continues in the plane with the velocity of its rear axle and its present
    heading, and footprints are boxes. Turning is ignored, so a car that steers clear of
    a wall has a finite time to it.
    """
    pose, size = motion.pose_w[:, None], motion.size[:, None]
    own = rotate(motion.velocity_b, motion.pose_w[..., 2])[:, None]

    def contact_time(group: Group) -> jax.Array:
        gap = group.gaps(motion.pose_w[:, :2])
        relative = own if group.velocity_w is None else own - group.velocity_w

        def find(index: jax.Array) -> jax.Array:
            near = take(group, index)
            towards = own if near.velocity_w is None else own - near.velocity_w
            return near.contact_time(pose, size, towards)

        # Lower bounds: the gap of the circle about the car over the relative speed,
        # inf where they keep their distance.
        free = gap - norm(motion.size)[:, None] / 2 - MARGIN
        bound = jnp.where(free > 0.0, free / norm(relative), 0.0)
        bound = jnp.where(group.counts(motion.size.shape[0]), bound, jnp.inf)
        return least_near(bound, find, HORIZON, NEAREST_CHUNK)

    return _least_by_kind(obstacles, contact_time)


def first_safety(kinds: Sequence[ObstacleKind]) -> dict[str, float]:
    """Names, and values at the start of an episode, of what agents can hit."""
    labels = [kind.label for kind in kinds]
    return {
        **dict.fromkeys(("acceleration_sum", "jerk_sum"), 0.0),
        **dict.fromkeys(("peak_acceleration", "peak_jerk"), 0.0),
        **dict.fromkeys(("last_acceleration_x", "last_acceleration_y"), 0.0),
        **{f"min_clearance_{label}": RANGE for label in labels},
        **{f"min_collision_time_{label}": HORIZON for label in labels},
    }


def measure_safety(ctrl_dt: float, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `first_safety`."""
    after = transition.after
    motion = after.motion
    there = lot_obstacles(after.layout, motion, after.parked_cars, after.movers)
    gaps, times = clearances(motion, there), collision_times(motion, there)

    def velocity_w(motion: Motion) -> jax.Array:
        return rotate(motion.velocity_b, motion.pose_w[..., 2])

    # Of the rear axle: differences over control steps, as vectors in the plane, so that
    # lateral acceleration counts as braking does.
    gained = velocity_w(motion) - velocity_w(transition.before.motion)
    x, y = jnp.moveaxis(gained / ctrl_dt, -1, 0)
    last = transition.before.stats.tallies
    acceleration = jnp.hypot(x, y)
    jerk = jnp.hypot(x - last["last_acceleration_x"], y - last["last_acceleration_y"])
    jerk = jerk / ctrl_dt
    return {
        "acceleration_sum": acceleration,
        "peak_acceleration": acceleration,
        "jerk_sum": jerk,
        "peak_jerk": jerk,
        "last_acceleration_x": x,
        "last_acceleration_y": y,
        **{f"min_clearance_{kind}": gap for kind, gap in gaps.items()},
        **{f"min_collision_time_{kind}": time for kind, time in times.items()},
    }
