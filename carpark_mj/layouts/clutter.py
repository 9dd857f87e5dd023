"""One bay among pieces of outlines, as the sensors of a car perceive a place to park.

Unlike in other families nothing is complete: walls end, a parked car is a corner or a
face, boxes and discs stand about. The defaults are close to half of the cases that a
car recorded (ParkBench); the other half is held out.

An aisle runs along x, the bay lies below it. Lengths of the aisle scale with the car,
gaps beside it do not.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import Bounds, Range, Ratio
from carpark_mj.geometry import box_corners, box_disc_overlap, boxes_overlap, norm
from carpark_mj.layouts import build
from carpark_mj.layouts.base import LayoutConfig, register_layout
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import BayEnd, Layout

MARGINS = (0.1, 0.2, 0.3)  # m of the bay around the car: the largest that is free
THICKNESS: Range = (0.02, 0.05)  # m, of walls
SETBACK: Range = (-0.4, 0.9)  # m from the aisle's edge to the parked car
AHEAD: Range = (-1.5, 0.4)  # m by which neighbours stand nearer to the aisle
EDGE: Range = (0.3, 5.0)  # m, lengths of walls across the aisle
FACE: Range = (0.4, 2.2)  # m, lengths of walls along it
FACE_OPPOSITE: Range = (0.6, 4.0)  # m
DEPTH: Range = (-0.4, 2.0)  # m from the aisle's edges to what lies along it
BOX: Range = (0.05, 1.2)  # m, sides of boxes
RADIUS: Range = (0.05, 0.35)  # m, of discs
LEAN = math.radians(50)  # largest deviation of the bay from a right angle [rad]
TILT = math.radians(25)  # largest deviation of walls from their direction [rad]
# In car lengths.
PITCH = 0.8  # of places along the aisle
END: Range = (1.2, 3.5)  # from the bay to the ends of the aisle
NEAR = (2.0, 1.8)  # farthest starts along the aisle and across it
FAR = (3.4, 2.0)  # the same of starts anywhere
HALF_EXTENT = (4.0, 3.2)
# Chances that a place is taken, beside the bay and elsewhere at a density of 1.
BESIDE, BEHIND, ROW, ENDED = 0.8, 0.7, 0.9, 0.4
OPEN = 0.05  # density below which there is nothing at all
CELLS, OPPOSITE = 2, 5  # places on either side of the bay, and opposite
BOXES, DISCS, STARTS = 6, 3, 8
FREE = 4  # of `_boxes` in which nothing stands
START = 0.02  # m, side of a spawn region
CLEAR = 0.1  # m around a start
STRAY = 0.5  # largest deviation of most starts from the aisle's direction [rad]
ASKEW, ANYWHERE = 0.25, 0.12  # shares of starts with any heading, and anywhere


@dataclasses.dataclass(frozen=True)
class ClutterConfig(LayoutConfig):
    """One bay among pieces of outlines.

    Attributes:
        car: the car that lots are drawn for.
        largest: the largest car; a lot is drawn for a size in between. None = `car`.
        gap: from the parked car to what stands beside and behind it [m].
        corridor: width of the aisle, in lengths of the car.
        density: share of the places for walls, boxes and discs that are taken, drawn
            for every lot; below 0.05 nothing stands there.
        parallel: share of the bays that lie along the aisle.
        nose_first: share of the bays that a car must enter with its nose first.
        tail_first: share of the bays that a car must enter tail first; the
            other bays allow either end.
    """

    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    largest: DesignCar | None = None
    gap: Annotated[Range, Bounds(ge=0.15, le=10.0, unit="m")] = (0.2, 1.2)
    corridor: Annotated[Range, Bounds(ge=0.5, le=2.5)] = (0.65, 1.7)
    density: Annotated[Range, Bounds(ge=0.0, le=1.0)] = (0.0, 1.0)
    parallel: Ratio = 0.2
    nose_first: Ratio = 0.2
    tail_first: Ratio = 0.4
    family: str = "clutter"
    is_enclosed = False  # cars can leave

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.nose_first + self.tail_first > 1.0:
            raise ValueError(
                "nose_first + tail_first must be at most 1, not "
                f"{self.nose_first:g} + {self.tail_first:g}"
            )

    @property
    def min_bays(self) -> int:
        """One, the goal."""
        return 1

    def split(self) -> tuple[Callable[..., Layout], dict[str, Any]]:
        """All settings share one program."""
        names = ("gap", "corridor", "density", "parallel", "nose_first", "tail_first")
        numbers = {name: getattr(self, name) for name in names}
        numbers |= {"car": self.car.size, "largest": (self.largest or self.car).size}
        return _draw_lot, {k: np.array(x, np.float32) for k, x in numbers.items()}

    def generate(self, key: jax.Array) -> Layout:
        """Draws a lot."""
        return _draw_lot(self.split()[1], key)


def _draw_lot(numbers: dict[str, Any], key: jax.Array) -> Layout:
    """Draws a lot."""
    counts = (11, 6 * STARTS, 4 * DISCS, 6 * _WALLS)
    ends = [sum(counts[:k]) for k in range(1, 5)]
    chance, *chances = jnp.split(build.chances(key, ends[-1]), ends[:-1])
    parts = zip(chances, (STARTS, DISCS, _WALLS), strict=True)
    starts, discs, walls = (x.reshape(-1, n) for x, n in parts)
    slot = _draw_slot(numbers, chance)
    room = slot.car + 2.0 * CLEAR + START
    start = _draw_starts(slot, room, starts)
    boxes = _boxes(slot, start, room)
    pose, wall_size, wall = _draw_walls(slot, walls)
    meets = boxes_overlap(pose[:, None], wall_size[:, None], *boxes)
    wall = wall & ~meets[:, :FREE].any(axis=1)
    taken = (meets & wall[:, None]).any(axis=0)
    centre = build.stacked(*_anywhere(slot, discs))
    radius = build.draw(discs[3], RADIUS)
    disc = (discs[2] < slot.density) & (slot.density >= OPEN)
    meets = box_disc_overlap(*boxes, centre[:, None], radius[:, None])
    disc = disc & ~meets[:, :FREE].any(axis=1)
    taken = taken | (meets & disc[:, None]).any(axis=0)
    margin = jnp.array(MARGINS)[len(MARGINS) - 1 - taken[-2:].sum()]
    largest = slot.car + 2.0 * MARGINS[-1]
    taken = taken[FREE - 1 : -2] | boxes_overlap(start, room, slot.pose, largest)
    most = numbers["largest"][0]
    shift = 0.5 * most * jnp.array([0.0, 1.0, 0.0])
    bay = (slot.pose - shift)[None], slot.car + 2.0 * margin
    return build.assemble(
        jnp.array(HALF_EXTENT) * most,
        build.bays(*bay, end=slot.end),
        build.walls(pose - shift, wall_size, mask=wall),
        build.discs(centre - shift[:2], radius, mask=disc),
        build.spawns(start - shift, (START, START), 0.0, mask=~taken),
    )


class _Slot(NamedTuple):
    """What a lot is drawn around."""

    car: jax.Array  # (2,) length and width of the car [m]
    pose: jax.Array  # (3,) of the bay
    end: jax.Array  # () int32, a `BayEnd`
    out: jax.Array  # (2,) unit vector out of the bay into the aisle
    half: jax.Array  # (2,) half extents of the parked car along `out` and across [m]
    gaps: jax.Array  # (3,) from it to what stands on its left, right and behind it [m]
    aisle: jax.Array  # () width [m]
    density: jax.Array  # () share of places that are taken

    @property
    def right(self) -> jax.Array:
        """(2,) unit vector to the right, seen from the bay's far end."""
        return jnp.stack([self.out[1], -self.out[0]])

    @property
    def mouth(self) -> jax.Array:
        """(2,) middle of the edge at which the bay is entered."""
        return self.pose[:2] + (self.half[0] + MARGINS[0]) * self.out


def _draw_low(chance: jax.Array, bounds: Range) -> jax.Array:
    """Draws from a range; half of the numbers are in its first quarter."""
    return build.draw(chance**2, bounds)


def _stray(chance: jax.Array, most: float) -> jax.Array:
    """Draws a deviation; half are within an eighth of the largest."""
    return most * (2.0 * chance - 1.0) ** 3


def _draw_slot(numbers: dict[str, Any], chance: jax.Array) -> _Slot:
    """Draws the car, the bay and the aisle, by chances (11,)."""
    car = numbers["car"] + chance[0] * (numbers["largest"] - numbers["car"])
    parallel = chance[1] < numbers["parallel"]
    half = jnp.where(parallel, car[::-1], car) / 2
    angle = jnp.pi / 2 + _stray(chance[2], LEAN)
    out = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    reach = half[0] * out[1] + half[1] * jnp.abs(out[0])
    # A parallel bay may point either way.
    aside = jnp.where(chance[3] < 0.5, jnp.pi / 2, -jnp.pi / 2)
    yaw = angle + jnp.where(parallel, aside, 0.0)
    gaps = _draw_low(chance[4:7], numbers["gap"])
    tail = chance[7] >= 1.0 - numbers["tail_first"]
    end = jnp.where(tail, BayEnd.TAIL_FIRST, BayEnd.EITHER)
    least, most = numbers["density"]  # many pieces are more likely than few
    return _Slot(
        car=car,
        pose=build.stacked(0.0, -build.draw(chance[8], SETBACK) - reach, yaw),
        end=jnp.where(chance[7] < numbers["nose_first"], BayEnd.NOSE_FIRST, end),
        out=out,
        half=half,
        gaps=gaps,
        aisle=car[0] * _draw_low(chance[9], numbers["corridor"]),
        density=_draw_low(chance[10], (most, least)),
    )


def _draw_starts(slot: _Slot, room: jax.Array, chance: jax.Array) -> jax.Array:
    """Draws poses (n, 3) of starts with `room` (2,) [m]; the first is in the aisle."""
    x, y, turn, stray, kind, place = chance
    length = slot.car[0]
    askew = jnp.pi * (2.0 * stray - 1.0)
    yaw = jnp.where(kind < ASKEW, askew, _stray(stray, STRAY))
    yaw = yaw + jnp.where(turn < 0.5, jnp.pi, 0.0)
    sin, cos = jnp.abs(jnp.sin(yaw)), jnp.abs(jnp.cos(yaw))
    reach = (room[0] * sin + room[1] * cos) / 2
    bay = box_corners(slot.pose, slot.car + 2.0 * MARGINS[-1])
    top = jnp.maximum(bay[:, 1].max(), 0.0)
    across = jnp.minimum(slot.aisle, NEAR[1] * length) - top - 2.0 * reach
    aside = 2.0 * x - 1.0
    ahead = top + reach + jnp.maximum(across, 0.0) * y
    far_ahead = slot.aisle / 2 + FAR[1] * length * (2.0 * y - 1.0)
    anywhere = (place < ANYWHERE) & (jnp.arange(STARTS) > 0)
    return build.stacked(
        length * aside * jnp.where(anywhere, FAR[0], NEAR[0] * jnp.abs(aside)),
        jnp.where(anywhere, far_ahead, ahead),
        yaw,
    )


def _boxes(
    slot: _Slot, start: jax.Array, room: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Poses (n, 3) and sizes (n, 2) of the bay, the ground before it and all starts.

    Nothing stands in the first `FREE`: the smallest bay, the ground right before it,
    the straight way to the first start, and that start. The last two are larger bays.
    """
    before, way = 0.3 * slot.car[0], start[0, :2] - slot.mouth
    out = jnp.arctan2(slot.out[1], slot.out[0])
    poses = [
        slot.pose,
        jnp.append(slot.mouth + before / 2 * slot.out, out),
        jnp.append(slot.mouth + way / 2, jnp.arctan2(way[1], way[0])),
    ]
    poses = [jnp.stack(poses), start, slot.pose[None], slot.pose[None]]
    bay, larger, largest = (slot.car + 2.0 * margin for margin in MARGINS)
    sizes = [
        bay,
        jnp.stack([before, 2.0 * (slot.half[1] + MARGINS[0])]),
        jnp.stack([norm(way), slot.car[1]]),
        *([room] * STARTS),
        *(larger, largest),
    ]
    return jnp.concatenate(poses), jnp.stack(sizes)


def _draw_walls(
    slot: _Slot, chance: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Draws walls by numbers (6, n): poses (n, 3), sizes (n, 2) and mask (n,)."""
    groups, first = [], 0
    for count, place in _PLACES:
        groups += place(slot, chance[:4, first : first + count])
        first += count
    parts = [jnp.broadcast_arrays(*group) for group in groups]
    x, y, yaw, length, likely = map(jnp.concatenate, zip(*parts, strict=True))
    taken = chance[4] < likely
    thin, box = build.draw(chance[5], THICKNESS), build.draw(chance[5], BOX)
    width = jnp.where(jnp.arange(_WALLS) < _WALLS - BOXES, thin, box)
    x, y = x + length / 2 * jnp.cos(yaw), y + length / 2 * jnp.sin(yaw)
    mask = taken & (slot.density >= OPEN)
    return build.stacked(x, y, yaw), build.stacked(length, width), mask


# Walls from a point in a direction: x and y [m], yaw [rad], length [m], and how likely
# each is there; all broadcast to (n,).
_Group = tuple[Any, Any, Any, Any, Any]


def _beside(slot: _Slot, chance: jax.Array) -> list[_Group]:
    """Three sides of what stands on the left and on the right, by numbers (4, 6)."""
    side, along = jnp.array([-1.0, 1.0]), jnp.array([jnp.pi, 0.0])
    down = jnp.arctan2(slot.out[1], slot.out[0]) + jnp.pi
    ahead, edge = build.draw(chance[0, :2], AHEAD), build.draw(chance[0, 2:4], EDGE)
    face, far_edge = build.draw(chance[0, 4:], FACE), build.draw(chance[1, :2], EDGE)
    tilt = _stray(chance[1:4, 4:], TILT)
    aside = side * (slot.half[1] + slot.gaps[:2])
    corner = slot.pose[:2] + (slot.half[0] + ahead)[:, None] * slot.out
    x, y = (corner + aside[:, None] * slot.right).T
    far = x + side * face
    return [  # edges lean away from the bay
        (x, y, down + side * jnp.abs(tilt[0]), edge, BESIDE),
        (x, y, along + tilt[1], face, BESIDE),
        (far, y, down + tilt[2], far_edge, 0.5),
    ]


def _behind(slot: _Slot, chance: jax.Array) -> list[_Group]:
    """A wall behind the bay, by numbers (4, 1)."""
    length = build.draw(chance[0], EDGE)
    tilt = _stray(chance[1], TILT)
    back = slot.pose[:2] - (slot.half[0] + slot.gaps[2]) * slot.out
    x, y = back - slot.half[1] * slot.right
    yaw = jnp.arctan2(slot.right[1], slot.right[0]) + tilt
    return [(x, y, yaw, length, BEHIND * slot.density)]


def _in_row(slot: _Slot, chance: jax.Array) -> list[_Group]:
    """Corners along the aisle on either side of the bay, by numbers (4, 4 CELLS)."""
    side = jnp.repeat(jnp.array([-1.0, 1.0]), CELLS)
    chance = chance.reshape(8, 2 * CELLS)
    cell = jnp.tile(jnp.arange(CELLS), 2) + chance[0]
    x = side * (slot.half.max() + 1.5 + PITCH * slot.car[0] * cell)
    y = -build.draw(chance[1], DEPTH)
    tilt = _stray(chance[2:4], TILT)
    along = jnp.where(side > 0, 0.0, jnp.pi) + tilt[0]
    likely = ROW * slot.density
    return [
        (x, y, along, build.draw(chance[4], FACE), likely),
        (x, y, tilt[1] - jnp.pi / 2, build.draw(chance[5], EDGE), likely),
    ]


def _opposite(slot: _Slot, chance: jax.Array) -> list[_Group]:
    """Corners along the other side of the aisle, by numbers (4, 2 OPPOSITE)."""
    chance = chance.reshape(8, OPPOSITE)
    cell = jnp.arange(OPPOSITE) - OPPOSITE / 2 + chance[0]
    x = PITCH * slot.car[0] * cell
    # A wall, or the faces of what stands at different depths.
    depth = jnp.where(chance[6, 0] < 0.4, 0.0, build.draw(chance[1], DEPTH))
    tilt = _stray(chance[2:4], TILT)
    y, likely = slot.aisle + depth, ROW * slot.density
    return [
        (x, y, tilt[0], build.draw(chance[4], FACE_OPPOSITE), likely),
        (x, y, tilt[1] + jnp.pi / 2, build.draw(chance[5], EDGE), likely),
    ]


def _across(slot: _Slot, chance: jax.Array) -> list[_Group]:
    """Two walls across each end of the aisle, by numbers (4, 4)."""
    side = jnp.array([-1.0, 1.0, -1.0, 1.0])
    up = jnp.array([False, False, True, True])
    x = side * slot.car[0] * build.draw(chance[0], END)
    y = jnp.where(up, slot.aisle + 1.0, -1.0)
    yaw = jnp.where(up, -jnp.pi / 2, jnp.pi / 2) + _stray(chance[1], TILT)
    length = build.draw(chance[2], (0.2, 0.8)) * (slot.aisle + 2.0)
    return [(x, y, yaw, length, ENDED * slot.density)]


def _scattered(slot: _Slot, chance: jax.Array) -> list[_Group]:
    """Boxes anywhere, by numbers (4, BOXES)."""
    x, y = _anywhere(slot, chance[:2])
    yaw = 2.0 * jnp.pi * chance[2]
    return [(x, y, yaw, build.draw(chance[3], BOX), slot.density)]


def _anywhere(slot: _Slot, chance: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Places by numbers (2, n): x and y (n,)."""
    length = slot.car[0]
    x = 2.2 * length * (2.0 * chance[0] - 1.0)
    return x, -1.2 * length + (1.8 * length + slot.aisle) * chance[1]


# How many walls each function draws.
_PLACES: tuple[tuple[int, Callable[[_Slot, jax.Array], list[_Group]]], ...] = (
    (6, _beside),
    (1, _behind),
    (4 * CELLS, _in_row),
    (2 * OPPOSITE, _opposite),
    (4, _across),
    (BOXES, _scattered),
)
_WALLS = sum(count for count, _ in _PLACES)


# Design cars from a small car to a large saloon, and on to a long van.
_SMALL = DesignCar(length=3.5, width=1.62, wheelbase=2.4, rear_overhang=0.55)
_LARGE = DesignCar(length=4.95, width=2.0, wheelbase=2.95, rear_overhang=1.05)
_LONG = DesignCar(length=7.0, width=2.1, wheelbase=4.3, rear_overhang=1.65)
_ROOM = {
    "": ClutterConfig(),
    "_roomy": ClutterConfig(gap=(0.6, 1.5), corridor=(1.3, 2.2), density=(0.0, 0.6)),
    "_tight": ClutterConfig(gap=(0.15, 0.6), corridor=(0.7, 1.05), density=(0.6, 1.0)),
}
for _name, _config in _ROOM.items():
    register_layout(f"clutter{_name}", _config)
    register_layout(
        f"clutter_sizes{_name}",
        dataclasses.replace(_config, car=_SMALL, largest=_LARGE),
    )
register_layout("clutter_vans", ClutterConfig(car=_LARGE, largest=_LONG))
# Slots along a kerb or a wall.
register_layout(
    "clutter_parallel",
    ClutterConfig(car=_SMALL, largest=_LARGE, gap=(0.15, 0.8), parallel=1.0),
)
