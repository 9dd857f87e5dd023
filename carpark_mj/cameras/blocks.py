"""What stands in a lot as upright boxes and cylinders with heights."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.cameras.rig import BODY, CABIN, CarBlock, Seen
from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry.obstacles import Boxes, Group
from carpark_mj.geometry.se2 import move_forward
from carpark_mj.layouts.types import (
    DISC_HEIGHTS,
    GROUND_CLEARANCE,
    MOVER_HEIGHTS,
    WALL_HEIGHTS,
    DiscKind,
    Layout,
    WallKind,
)
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
    """Heights of cars over their lengths, by their kinds in `State`.

    Attributes:
        agents: `State.kind`.
        parked_cars: `ParkedCars.kind`.
    """

    agents: tuple[float, ...]
    parked_cars: tuple[float, ...]

    @classmethod
    def of(cls, fleet: Any) -> "Heights":
        """Those of an environment's cars, `ParkingEnv.fleet`."""
        both = (fleet.agents, fleet.parked_cars)
        return cls(*(tuple(car.height / car.length for car in cars) for cars in both))


@struct.dataclass
class Blocks:
    """Upright boxes or cylinders (n,); world frame.

    Attributes:
        pose_w: (n, 3) centres and headings.
        half: (n, 2) half length and half width [m], twice the radius of a cylinder;
            negative where there is none.
        low: (n,) height of the underside [m].
        high: (n,) height of the top [m].
        seen: (n,) int32 what a pixel shows there, `Seen`.
        owner: (n,) int32 the agent whose car it is part of, or `NOBODY`.
    """

    pose_w: jax.Array
    half: jax.Array
    low: jax.Array
    high: jax.Array
    seen: jax.Array
    owner: jax.Array


def lot_blocks(
    state: State, heights: Heights, of_cars: Sequence[CarBlock] = (BODY, CABIN)
) -> tuple[Blocks, Blocks]:
    """The boxes and the cylinders of a lot.

    Args:
        state: of the lot.
        heights: of its cars.
        of_cars: what a car consists of.
    """
    boxes, cylinders = [], []
    groups = lot_obstacles(state.layout, state.motion, state.parked_cars, state.movers)
    for group in groups:
        if not group.count:
            continue
        if group.kind in (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR):
            boxes += [_car(block, group, state, heights) for block in of_cars]
        elif type(group) is Boxes:
            boxes.append(_solid(group, *_look(group, state.layout)))
        else:
            cylinders.append(_solid(group, *_look(group, state.layout)))
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
        low=jnp.maximum(low * height, GROUND_CLEARANCE),
        high=high * height,
        seen=jnp.full(count, Seen.CAR),
        owner=owner,
    )


def _look(group: Group, layout: Layout) -> tuple[jax.Array, jax.Array]:
    """Heights (n,) [m] and looks (n,) of walls, discs and movers."""
    count, box = group.count, type(group) is Boxes
    if group.kind != ObstacleKind.WALL:
        seen = Seen.PERSON if group.kind == ObstacleKind.PERSON else Seen.CAR
        return jnp.full(count, MOVER_HEIGHTS[type(group)]), jnp.full(count, seen)
    if not box:
        high = jnp.array([DISC_HEIGHTS[kind] for kind in DiscKind])[layout.disc_kind]
        return high, jnp.full(count, Seen.WALL)
    high = jnp.array([WALL_HEIGHTS[kind] for kind in WallKind])[layout.wall_kind]
    return high, jnp.array([_WALLS[kind] for kind in WallKind])[layout.wall_kind]


def _solid(group: Group, high: jax.Array, seen: jax.Array) -> Blocks:
    """Obstacles that stand on the ground."""
    pose, count = group.pose_w, group.count
    if type(group) is Boxes:
        half = group.size / 2
    else:
        pose = jnp.pad(pose, ((0, 0), (0, 1)))
        half = jnp.stack([group.size, group.size], axis=-1)
    return Blocks(
        pose_w=pose,
        half=_present(half, group.mask),
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
