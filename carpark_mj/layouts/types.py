"""A layout: the plan of a lot as a pytree of padded arrays.

Masks say which rows count, so lots of different shapes share one compiled program and
one batch. Padding rows hold finite numbers (zeros).
"""

import dataclasses
import enum
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import wrap_angle
from carpark_mj.geometry.obstacles import Boxes, Discs, Group

# Kinds of rows: the first part of a field's name.
ROWS = ("bay", "wall", "disc", "lane", "spawn")
WALL_HEIGHT = 0.9  # low enough for the cameras of videos
KERB_HEIGHT = 0.14
MOVER_HEIGHTS: dict[type[Group], float] = {Boxes: 1.1, Discs: 1.7}  # cart, person
GROUND_CLEARANCE = 0.16  # under a car
LINE_WIDTH = 0.10  # painted bay lines
LINE_HEIGHT = 0.004  # above the asphalt so that it is not hidden
ARROW_LENGTH, ARROW_WIDTH = 2.0, 0.8
ARROW_HEAD = 0.4  # share of its length
ARROW_SHAFT = 0.3  # width of its shaft over that of its head
ARROW_HEIGHT = LINE_HEIGHT / 2
ARROW_SPACING = 9.0  # along a lane
VERGE_GAP, VERGE_HEIGHT = 1.0, 0.01  # asphalt left around the walls, and grass


class BayKind(enum.IntEnum):
    """The use of a bay."""

    STANDARD = 0
    ACCESSIBLE = 1
    FAMILY = 2
    RESERVED = 3  # for parked cars: no agent's goal while another bay is free
    EXIT = 4  # a lane out of the lot, goal of cars that leave: `GoalConfig.drive_out`


class BayEnd(enum.IntEnum):
    """Which end of a car goes into a bay first."""

    EITHER = 0
    NOSE_FIRST = 1
    TAIL_FIRST = 2


class WallKind(enum.IntEnum):
    """Look of a solid box; all kinds collide alike."""

    WALL = 0
    KERB = 1
    ISLAND = 2
    GATE = 3


class DiscKind(enum.IntEnum):
    """Look of a solid disc; all kinds collide alike."""

    PILLAR = 0
    BOLLARD = 1


@struct.dataclass
class Layout:
    """The plan of a lot; world frame, SI units.

    Rows of a kind have leading dimensions (..., n); bool masks say which of them count.
    Poses (..., n, 3) are centres and headings [m, m, rad], sizes (..., n, 2) lengths
    along the headings and widths [m].

    Attributes:
        bay_pose: the heading is that of parked cars: out into the aisle, or along the
            street in a parallel bay.
        bay_kind: int32, `BayKind`.
        wall_pose: of walls, blocks, islands...
        wall_kind: int32, `WallKind`.
        disc_centre: (..., discs, 2) of each pillar or bollard [m].
        disc_radius: (..., discs) [m].
        disc_kind: int32, `DiscKind`.
        lane_pose: the heading is the direction of travel.
        lane_one_way: bool; False where both directions are allowed.
        spawn_pose: of regions, rectangles in which car centres may spawn; a region is
            drawn in proportion to its area.
        spawn_spread: largest deviation of a spawning car's heading from the region's
            [rad]; pi = any heading.
        extent: (..., 2) half width in x and half width in y of the whole lot, about
            the origin [m].
        bay_end: int32, `BayEnd`; None = either end in every bay.
    """

    bay_pose: jax.Array
    bay_size: jax.Array
    bay_kind: jax.Array
    bay_mask: jax.Array
    wall_pose: jax.Array
    wall_size: jax.Array
    wall_kind: jax.Array
    wall_mask: jax.Array
    disc_centre: jax.Array
    disc_radius: jax.Array
    disc_kind: jax.Array
    disc_mask: jax.Array
    lane_pose: jax.Array
    lane_size: jax.Array
    lane_one_way: jax.Array
    lane_mask: jax.Array
    spawn_pose: jax.Array
    spawn_size: jax.Array
    spawn_spread: jax.Array
    spawn_mask: jax.Array
    extent: jax.Array
    bay_end: jax.Array | None = None

    @property
    def num_bays(self) -> int:
        """Bays, padding included."""
        return self.bay_mask.shape[-1]

    @property
    def goal_mask(self) -> jax.Array:
        """(..., bays) bool, the bays that fixed goals are drawn from."""
        return self.bay_mask & (self.bay_kind != BayKind.RESERVED)

    @property
    def parked_pose(self) -> jax.Array:
        """(..., bays, 3) `bay_pose`, turned where a car's nose must go in first."""
        if self.bay_end is None:
            return self.bay_pose
        yaw = self.bay_pose[..., 2]
        turns = self.bay_end == BayEnd.NOSE_FIRST
        yaw = jnp.where(turns, wrap_angle(yaw + jnp.pi), yaw)
        return jnp.concatenate([self.bay_pose[..., :2], yaw[..., None]], axis=-1)

    @property
    def has_lanes(self) -> bool:
        """Whether lots of this shape can have lanes."""
        return self.lane_mask.shape[-1] > 0

    @property
    def one_way(self) -> jax.Array | None:
        """(..., bays) bool, whether cars stand only as `parked_pose`; None = none."""
        return None if self.bay_end is None else self.bay_end != BayEnd.EITHER


@dataclasses.dataclass(frozen=True)
class Maxima:
    """Numbers of rows, padding included."""

    bays: int
    walls: int
    discs: int
    lanes: int
    spawns: int
    bay_ends: bool = False  # whether `Layout.bay_end` is an array


def layout_maxima(layouts: Iterable[Layout]) -> Maxima:
    """The fewest rows that hold every one of the layouts (arrays or their shapes)."""
    layouts = list(layouts)
    return Maxima(
        *(max(getattr(x, f"{kind}_mask").shape[-1] for x in layouts) for kind in ROWS),
        bay_ends=any(x.bay_end is not None for x in layouts),
    )


def pad_layout(layout: Layout, maxima: Maxima) -> Layout:
    """Pads one layout (no batch dimension) to as many rows or more."""
    rows = {kind: getattr(maxima, f"{kind}s") for kind in ROWS}
    if maxima.bay_ends and layout.bay_end is None:
        either = jnp.full(layout.bay_mask.shape, BayEnd.EITHER, jnp.int32)
        layout = dataclasses.replace(layout, bay_end=either)
    changes = {}
    for field in dataclasses.fields(layout):
        kind, array = field.name.split("_")[0], getattr(layout, field.name)
        if kind not in rows or array is None:
            continue
        if extra := rows[kind] - array.shape[0]:
            rest = jnp.zeros((extra, *array.shape[1:]), array.dtype)
            changes[field.name] = jnp.concatenate([array, rest])
    return dataclasses.replace(layout, **changes)


def enlarge(layout: Layout, factor: jax.Array | float) -> Layout:
    """A lot of which all lengths are larger by a factor; headings stay."""
    pose = jnp.stack([factor, factor, 1.0]).astype(jnp.float32)
    larger = _times(layout, pose=pose, centre=factor, size=factor, radius=factor)
    return dataclasses.replace(larger, extent=layout.extent * factor)


def mirror(layout: Layout) -> Layout:
    """A lot whose left is right: y and headings have the other sign."""
    pose, centre = jnp.array([1.0, -1.0, -1.0]), jnp.array([1.0, -1.0])
    return _times(layout, pose=pose, centre=centre)


def _times(layout: Layout, **factors: Any) -> Layout:
    """A lot whose fields are multiplied, all that have a part, as `bay_size` `size`."""
    changes = {
        field.name: getattr(layout, field.name) * factors[part]
        for field in dataclasses.fields(layout)
        if (part := field.name.partition("_")[2]) in factors
    }
    return dataclasses.replace(layout, **changes)


WALL_HEIGHTS = {
    WallKind.WALL: WALL_HEIGHT,
    WallKind.KERB: KERB_HEIGHT,
    WallKind.ISLAND: KERB_HEIGHT,
    WallKind.GATE: WALL_HEIGHT,
}
DISC_HEIGHTS = {DiscKind.PILLAR: 2.4, DiscKind.BOLLARD: 0.9}
