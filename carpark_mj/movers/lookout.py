"""What drivers see on their paths, and which of two has priority.

Paths are cut into sections; a section is the box that the car sweeps there. A driver
reacts to the nearest section that is occupied now or lies within another car's stopping
distance, or farther ahead of a car with priority. The car that yields allows for a
control step of acceleration of the other. So stopping distances never overlap, and
attentive drivers never collide.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.geometry import move_forward, norm, to_local
from carpark_mj.geometry.obstacles import Boxes, ObstacleKind
from carpark_mj.movers.traffic import (
    BACK_OUT,
    DRIVE,
    OFFSET,
    PARK,
    SIZE,
    STAY,
    Traffic,
    choose,
)
from carpark_mj.types import State

PATIENCE = 6.0  # s of standing after which who waits longest goes first
EDGES = (0.0, 0.4, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.5)  # m, of the sections
ASIDE, ALONG = 0.3, 0.15  # m of room about a car
HARD = 3.0  # m/s², with which drivers reckon to stop; cars brake with 4
YIELDS_FOR = 2.5  # s before another driver that goes first
OUT = 3.0  # m of a way out of a bay with limited sight
SIGHT = 1.5  # m to either side for each metre behind a bay
SOON = 1.0  # s, where people will be
PERSON = 0.3  # m of room about a person


def goes_first(traffic: Traffic) -> jax.Array:
    """(n, n) bool, whether the second of a pair goes before the first; one of both.

    Who backs out yields, then who turns into a bay. Otherwise the car from the right
    goes first, and before one that turns left the oncoming. If somebody has waited for
    long, it is who has waited longest; last of all the more aggressive.
    """
    pose, phase = traffic.centre, traffic.phase
    local = to_local(pose[:, None], pose)
    y, turned = local[..., 1], local[..., 2]
    crosses = jnp.abs(jnp.sin(turned)) > 0.5
    from_right = crosses & (y < 0.0) & (y.T > 0.0)
    left = traffic.path.bend > 0.3
    oncoming = (jnp.cos(turned) < -0.7) & left[:, None] & ~left
    rank = jnp.where(phase == PARK, 1, jnp.where(phase == BACK_OUT, 0, 2))
    rank = jnp.where(phase == STAY, -1, rank)
    wait = jnp.where(traffic.clock > PATIENCE, traffic.clock, 0.0)
    order = jnp.arange(rank.shape[0])
    pushes = traffic.aggressiveness
    decisive = (pushes > pushes[:, None]) | (
        (pushes == pushes[:, None]) & (order < order[:, None])
    )

    def more(value: jax.Array, otherwise: jax.Array) -> jax.Array:
        return jnp.where(value == value[:, None], otherwise, value > value[:, None])

    rule = jnp.where(oncoming | oncoming.T, oncoming, decisive)
    rule = jnp.where(from_right | from_right.T, from_right, rule)
    return more(wait, more(rank, rule))


class Rows(NamedTuple):
    """Boxes (k, ...) that drivers (n,) see: poses, half sizes, velocities, who does."""

    pose: jax.Array
    half: jax.Array
    velocity: jax.Array
    seen: jax.Array


class Ahead(NamedTuple):
    """Free ways (n,) [m] of drivers and the speeds (n,) [m/s] of who is there."""

    gap: jax.Array
    speed: jax.Array


def look(traffic: Traffic, lot: State, accel: jax.Array, dt: float) -> Ahead:
    """What drivers with highest accelerations (n,) [m/s²] see ahead of them."""
    n, gear = traffic.way.shape[0], traffic.path.gear
    edges = jnp.array(EDGES)
    start, length = edges[:-1], jnp.diff(edges)
    way = traffic.way[:, None] + start + length / 2
    sections = move_forward(
        traffic.path.at(jnp.minimum(way, traffic.path.total[:, None])), OFFSET
    )
    boxes = jnp.concatenate([traffic.centre[:, None], sections], axis=1)
    longer = jnp.concatenate([jnp.zeros(1), length])
    half = SIZE / 2 + jnp.stack([longer / 2, jnp.zeros_like(longer)], axis=-1)
    room = half + jnp.array([ALONG, ASIDE])

    count = boxes.shape[1]
    shape = (n * count,)
    other_half = jnp.broadcast_to(half, (n, count, 2)).reshape(-1, 2)
    meets, gap = _meet(boxes, room, gear, boxes.reshape(-1, 3), other_half)
    meets = meets.reshape(n, count, n, count)
    gap = gap + jnp.concatenate([jnp.zeros(1), start])[:, None]
    limit = _limits(traffic, meets, accel, dt)
    begins = jnp.concatenate([jnp.full(1, -1.0), start])
    counts = (begins < limit[..., None]) & ~jnp.eye(n, dtype=bool)[..., None]
    counts = counts & traffic.present[:, None]
    meets = meets.reshape(n, count, -1) & counts.reshape(n, 1, -1)
    velocity = jnp.repeat(traffic.velocity, count, axis=0).reshape(*shape, 2)
    # The own box is for the right of way only.
    found = _first(boxes, gear, meets[:, 1:], gap[:, 1:], velocity)
    rows = _others(traffic, lot)
    if rows is not None:
        meets, gap = _meet(boxes, room, gear, rows.pose, rows.half)
        gap = gap + jnp.concatenate([jnp.zeros(1), start])[:, None]
        meets = meets & rows.seen[:, None]
        others = _first(boxes, gear, meets[:, 1:], gap[:, 1:], rows.velocity)
        found = choose(others.gap < found.gap, others, found)
    return found


def _first(
    boxes: jax.Array,
    gear: jax.Array,
    meets: jax.Array,
    gap: jax.Array,
    velocity: jax.Array,
) -> Ahead:
    """The nearest of rows (k,) that sections (n, m, k) meet, and its speed."""
    gap = jnp.where(meets, gap, jnp.inf)
    nearest = gap.min(axis=(1, 2))
    yaw = boxes[:, 1:, 2:]
    along = velocity[:, 0] * jnp.cos(yaw) + velocity[:, 1] * jnp.sin(yaw)
    along = jnp.maximum(along * gear[:, None, None], 0.0)
    first = gap <= nearest[:, None, None]
    speed = jnp.where(first & meets, along, jnp.inf).min(axis=(1, 2))
    return Ahead(nearest, jnp.where(jnp.isfinite(nearest), speed, 0.0))


def _meet(
    boxes: jax.Array, room: jax.Array, gear: jax.Array, pose: jax.Array, half: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Whether boxes (n, m, 3) of half sizes (m, 2) meet others (k, 3), (k, 2).

    Also the way (n, m, k) [m] from a section's beginning until they do.
    """
    x = pose[:, 0] - boxes[..., None, 0]
    y = pose[:, 1] - boxes[..., None, 1]
    own, other = boxes[..., None, 2], pose[:, 2]
    cos, sin = jnp.cos(own), jnp.sin(own)
    far, near = jnp.cos(other), jnp.sin(other)
    same, across = jnp.abs(cos * far + sin * near), jnp.abs(cos * near - sin * far)
    ahead = cos * x + sin * y
    half_x, half_y = room[:, :1], room[:, 1:]
    reach = same * half[:, 0] + across * half[:, 1]
    meets = jnp.abs(ahead) < half_x + reach
    meets = meets & (
        jnp.abs(cos * y - sin * x) < half_y + across * half[:, 0] + same * half[:, 1]
    )
    meets = meets & (
        jnp.abs(far * x + near * y) < half[:, 0] + same * half_x + across * half_y
    )
    meets = meets & (
        jnp.abs(far * y - near * x) < half[:, 1] + across * half_x + same * half_y
    )
    car = SIZE[0] / 2 + ALONG
    section = half_x - car  # half of its length
    free = gear[:, None, None] * ahead + section - car - reach
    return meets, jnp.clip(free, 0.0, 2.0 * section)


def _limits(
    traffic: Traffic, meets: jax.Array, accel: jax.Array, dt: float
) -> jax.Array:
    """(n, n) how much of the second's way the first leaves to it [m]."""
    speed, parked = traffic.speed, traffic.phase == STAY
    stop = speed**2 / (2.0 * HARD)
    faster = speed + accel * dt
    soon = (speed + faster) / 2 * dt + faster**2 / (2.0 * HARD)
    soon = jnp.where(parked, 0.0, soon)
    wish = jnp.where(traffic.phase == DRIVE, speed * YIELDS_FOR, 0.0)
    # Who stands where the other wants to go is further in, and goes on.
    wanted = jnp.array([-1.0, *EDGES[:-1]]) < wish[:, None]
    inside = (meets[:, 0] & wanted).any(axis=-1)
    wish = jnp.where(inside | _hidden(traffic, traffic.centre), 0.0, wish)
    limit = jnp.where(goes_first(traffic), jnp.maximum(soon, wish), stop)
    return jnp.where(traffic.attentive[:, None], limit, _blind(traffic)[:, None])


def _blind(traffic: Traffic) -> jax.Array:
    """(n,) what those who do not look see: cars before them, behind them nothing."""
    return jnp.where(traffic.path.gear > 0.0, 0.0, -2.0)


def _hidden(traffic: Traffic, pose: jax.Array) -> jax.Array:
    """(n, k) bool, whether neighbours hide poses (k, 3) from who backs out of a bay."""
    within = (traffic.phase == BACK_OUT) & (traffic.way < OUT)
    own = traffic.centre
    x, y = pose[:, 0] - own[:, :1], pose[:, 1] - own[:, 1:2]
    cos, sin = jnp.cos(own[:, 2:]), jnp.sin(own[:, 2:])
    behind = -(cos * x + sin * y) - SIZE[0] / 2
    aside = jnp.abs(cos * y - sin * x) - SIZE[1]
    return within[:, None] & (aside > SIGHT * jnp.maximum(behind, 0.0))


def _others(traffic: Traffic, lot: State) -> Rows | None:
    """Agents with the ways in which they stop; people, here and where they will be."""
    rows: list[tuple[jax.Array, ...]] = []
    motion = lot.motion
    if motion.size.shape[0]:
        yaw, along = motion.pose_w[:, 2], motion.speed
        stop = along * jnp.abs(along) / (2.0 * HARD)
        half = motion.size / 2
        half = half + jnp.stack([jnp.abs(stop) / 2, jnp.zeros_like(stop)], axis=-1)
        heading = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
        pose = move_forward(motion.pose_w, stop / 2)
        rows.append((pose, half, along[:, None] * heading, jnp.ones(yaw.shape, bool)))
    for group in lot.movers.groups:
        xy = group.pose_w[:, :2]
        still = jnp.zeros_like(xy)
        velocity = still if group.velocity_w is None else group.velocity_w
        is_box = isinstance(group, Boxes)
        yaw = group.pose_w[:, 2:] if is_box else jnp.zeros_like(xy[:, :1])
        half = group.size / 2 if is_box else jnp.stack([group.size] * 2, axis=-1)
        there = jnp.ones(group.count, bool) if group.mask is None else group.mask
        is_car = group.kind == ObstacleKind.DRIVER
        for later in (0.0,) if is_car else (0.0, SOON):
            pose = jnp.concatenate([xy + later * velocity, yaw], axis=-1)
            rows.append((pose, half + (0.0 if is_car else PERSON), velocity, there))
    if not rows:
        return None
    pose, half, velocity, there = (
        jnp.concatenate(column) for column in zip(*rows, strict=True)
    )
    blind = (_blind(traffic) < -1.0) & ~traffic.attentive
    seen = there & ~_hidden(traffic, pose) & ~blind[:, None]
    return Rows(pose, half, velocity, seen)


def is_clear(traffic: Traffic, lot: State, xy: jax.Array, reach: float) -> jax.Array:
    """() bool, whether nobody is within a distance [m] of a point (2,)."""
    clear = ~((norm(traffic.centre[:, :2] - xy) < reach) & traffic.present).any()
    clear = clear & ~(norm(lot.motion.xy - xy) < reach).any()
    for group in lot.movers.groups:
        near = norm(group.pose_w[:, :2] - xy) < reach
        clear = clear & ~(near if group.mask is None else near & group.mask).any()
    return clear
