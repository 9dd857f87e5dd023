"""What stands in a lot as upright boxes and cylinders, and rays that meet them."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.cameras import ground
from carpark_mj.cameras.ground import SHADES, Patches, Place
from carpark_mj.cameras.rig import BODY, CABIN, CarBlock, Seen
from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind
from carpark_mj.geometry.se2 import move_forward, rotate
from carpark_mj.layouts import types as lot
from carpark_mj.layouts.types import DiscKind, Layout, WallKind
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import State

NOBODY = -1
_WALLS = {
    WallKind.WALL: Seen.WALL,
    WallKind.KERB: Seen.KERB,
    WallKind.ISLAND: Seen.KERB,
    WallKind.GATE: Seen.WALL,
}


@dataclasses.dataclass(frozen=True)
class Heights:
    """Heights of cars over their lengths, by their kinds in `State`."""

    agents: tuple[float, ...]  # by `State.kind`
    parked_cars: tuple[float, ...]  # by `ParkedCars.kind`

    @classmethod
    def of(cls, fleet: Any) -> "Heights":
        """Heights of the cars of a fleet, as of `ParkingEnv.fleet`."""
        both = (fleet.agents, fleet.parked_cars)
        return cls(*(tuple(car.height / car.length for car in cars) for cars in both))


@struct.dataclass
class Blocks:
    """Upright boxes or cylinders (n,); world frame."""

    pose_w: jax.Array  # (n, 3) centres and headings
    # (n, 2) half length and width [m], or the radius twice; negative = there is none
    half: jax.Array
    low: jax.Array  # (n,) height of the underside [m]
    high: jax.Array  # (n,) height of the top [m]
    seen: jax.Array  # (n,) int32 what a pixel shows there, `Seen`
    owner: jax.Array  # (n,) int32 the agent whose car it is part of, or `NOBODY`


def lot_blocks(
    state: State, heights: Heights, of_cars: Sequence[CarBlock] = (BODY, CABIN)
) -> tuple[Blocks, Blocks]:
    """The boxes and the cylinders of a lot; a car consists of `of_cars`."""
    boxes, cylinders = [], []
    groups = lot_obstacles(state.layout, state.motion, state.parked_cars, state.movers)
    for group in groups:
        if not group.count:
            continue
        if group.kind in (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR):
            boxes += [_car(block, group, state, heights) for block in of_cars]
        else:
            kind = boxes if type(group) is Boxes else cylinders
            kind.append(_solid(group, *_look(group, state.layout)))
    return _join(boxes), _join(cylinders)


def _car(block: CarBlock, group: Group, state: State, heights: Heights) -> Blocks:
    """A part of every car."""
    count = group.count
    if group.kind == ObstacleKind.AGENT:
        ratios, kind, owner = heights.agents, state.kind, jnp.arange(count)
    else:
        ratios, kind = heights.parked_cars, state.parked_cars.kind
        owner = jnp.full(count, NOBODY)
    ratio = jnp.array(ratios, jnp.float32)
    ratio = ratio[0] if kind is None else ratio[kind]
    height = group.size[:, 0] * ratio
    rear, front, wide, low, high = block
    half = group.size / 2
    sides = half * jnp.array([(front - rear) / 2, wide])
    return Blocks(
        pose_w=move_forward(group.pose_w, half[:, 0] * (rear + front) / 2),
        half=_present(sides, group.mask),
        low=jnp.maximum(low * height, lot.GROUND_CLEARANCE),
        high=high * height,
        seen=jnp.full(count, Seen.CAR),
        owner=owner,
    )


def _look(group: Group, layout: Layout) -> tuple[jax.Array, jax.Array]:
    """Heights (n,) [m] and looks (n,) of walls, discs and movers."""
    count, box = group.count, type(group) is Boxes
    if group.kind != ObstacleKind.WALL:
        seen = Seen.PERSON if group.kind == ObstacleKind.PERSON else Seen.CAR
        return jnp.full(count, lot.MOVER_HEIGHTS[type(group)]), jnp.full(count, seen)
    if not box:
        high = jnp.array([lot.DISC_HEIGHTS[kind] for kind in DiscKind])
        return high[layout.disc_kind], jnp.full(count, Seen.WALL)
    high = jnp.array([lot.WALL_HEIGHTS[kind] for kind in WallKind])[layout.wall_kind]
    return high, jnp.array([_WALLS[kind] for kind in WallKind])[layout.wall_kind]


def _solid(group: Group, high: jax.Array, seen: jax.Array) -> Blocks:
    """Obstacles that stand on the ground."""
    (pose, size, _, mask), count = group.as_boxes, group.count
    return Blocks(
        pose_w=pose,
        half=_present(size / 2, mask),
        low=jnp.zeros(count),
        high=high,
        seen=seen,
        owner=jnp.full(count, NOBODY),
    )


def _present(half: jax.Array, mask: jax.Array | None) -> jax.Array:
    return half if mask is None else jnp.where(mask[:, None], half, -1.0)


def _join(blocks: list[Blocks]) -> Blocks:
    """Several as one."""
    if not blocks:
        empty, whole = jnp.zeros(0), jnp.zeros(0, jnp.int32)
        pair, pose = jnp.zeros((0, 2)), jnp.zeros((0, 3))
        return Blocks(pose, pair, empty, empty, whole, whole)
    return jax.tree.map(lambda *x: jnp.concatenate(x), *blocks)


SUN = (-0.34, -0.24, 0.91)  # unit vector to it, as in MuJoCo's scene
AMBIENT, DIFFUSE = 0.45, 0.55
FLAT = round(SHADES * (AMBIENT + DIFFUSE * SUN[2]))  # shade of what lies flat
_LEAST = 1e-9  # slope of a ray along a face


@struct.dataclass
class Seat:
    """Blocks (n,) as the camera of one car sees them."""

    base: Patches  # what they stand on; covers are `Seen`
    up: jax.Array  # (n,) height of the camera [m]
    span: jax.Array  # (n, 2) heights of the underside and the top [m]
    light: jax.Array  # (n, 2) the sun's share along the length and the width


def stand(blocks: Blocks, agent: jax.Array, place: Place) -> Patches:
    """What blocks stand on, as seen from a place on the car of an agent."""
    seen = jnp.where(blocks.owner == agent, Seen.OWN_CAR, blocks.seen)
    return ground.patches(blocks.pose_w, blocks.half, seen, place)


def seat(blocks: Blocks, agent: jax.Array, place: Place, height: jax.Array) -> Seat:
    """Blocks as the camera of one agent at a place and a height () [m] sees them."""
    return Seat(
        base=stand(blocks, agent, place),
        up=jnp.broadcast_to(height, blocks.low.shape),
        span=jnp.stack([blocks.low, blocks.high], axis=1),
        light=rotate(jnp.array(SUN[:2]), -blocks.pose_w[:, 2]),
    )


def trace(
    hit: jax.Array, rays: jax.Array, boxes: Seat, cylinders: Seat, shaded: bool
) -> jax.Array:
    """Hits (...) of rays (..., 3) in the car's frame, nearer than before."""
    slopes = [_off_zero(rays[..., k]) for k in range(3)]

    for blocks, meet in ((boxes, _meet_box), (cylinders, _meet_cylinder)):
        hit = ground.fold(
            hit,
            blocks,
            lambda hit, block, meet=meet: jnp.minimum(hit, meet(slopes, block, shaded)),
        )
    return hit


def _off_zero(slope: jax.Array) -> jax.Array:
    return jnp.where(jnp.abs(slope) < _LEAST, _LEAST, slope)


def _slab(start: jax.Array, half: jax.Array, slope: jax.Array):
    """Where a ray enters and leaves a slab about 0."""
    inverse = 1.0 / slope
    middle, reach = -start * inverse, half * jnp.abs(inverse)
    return middle - reach, middle + reach


def _storey(rays: list[jax.Array], block: Seat):
    """Where rays enter and leave the heights of a block."""
    half = (block.span[1] - block.span[0]) / 2
    return _slab(block.up - block.span[0] - half, half, rays[2])


def _meet_box(rays: list[jax.Array], box: Seat, shaded: bool) -> jax.Array:
    """Hits of rays with the outside of a box."""
    base = box.base
    dx = _off_zero(base.cos * rays[0] + base.sin * rays[1])
    dy = _off_zero(base.cos * rays[1] - base.sin * rays[0])
    enter_x, leave_x = _slab(base.xy[0], base.half[0], dx)
    enter_y, leave_y = _slab(base.xy[1], base.half[1], dy)
    enter_z, leave_z = _storey(rays, box)
    enter = jnp.maximum(jnp.maximum(enter_x, enter_y), enter_z)
    leave = jnp.minimum(jnp.minimum(leave_x, leave_y), leave_z)
    if not shaded:
        return _hit(enter, leave, box)
    aside = jnp.where(
        enter == enter_x, -jnp.sign(dx) * box.light[0], -jnp.sign(dy) * box.light[1]
    )
    light = jnp.where(enter == enter_z, -jnp.sign(rays[2]) * SUN[2], aside)
    return _hit(enter, leave, box, light)


def _meet_cylinder(rays: list[jax.Array], cylinder: Seat, shaded: bool) -> jax.Array:
    """Hits of rays with the outside of an upright cylinder."""
    base = cylinder.base
    dx = base.cos * rays[0] + base.sin * rays[1]
    dy = base.cos * rays[1] - base.sin * rays[0]
    x, y, radius = base.xy[0], base.xy[1], base.half[0]
    flat = 1.0 / (dx * dx + dy * dy)
    nearest, aside = -(x * dx + y * dy) * flat, x * dy - y * dx
    # From the chord, not from the quadratic formula, which cancels far away.
    chord = jnp.sqrt(jnp.maximum(radius**2 - aside * aside * flat, 0.0) * flat)
    missed = aside * aside * flat >= radius * jnp.abs(radius)
    enter_z, leave_z = _storey(rays, cylinder)
    enter = jnp.maximum(nearest - chord, enter_z)
    leave = jnp.where(missed, -1.0, jnp.minimum(nearest + chord, leave_z))
    if not shaded:
        return _hit(enter, leave, cylinder)
    at_x, at_y = x + enter * dx, y + enter * dy
    aside = (at_x * cylinder.light[0] + at_y * cylinder.light[1]) / radius
    light = jnp.where(enter == enter_z, -jnp.sign(rays[2]) * SUN[2], aside)
    return _hit(enter, leave, cylinder, light)


def _hit(
    enter: jax.Array, leave: jax.Array, block: Seat, light: jax.Array | None = None
) -> jax.Array:
    """Hits of what a ray enters; from inside it sees nothing of a block."""
    shade = SHADES
    if light is not None:
        level = AMBIENT + DIFFUSE * jnp.maximum(light, 0.0)
        shade = jnp.round(SHADES * level).astype(jnp.int32)
    met = (enter <= leave) & (enter > 0.0)
    return jnp.where(met, ground.encode(enter, block.base.cover, shade), ground.MISS)
