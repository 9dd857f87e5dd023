"""Cases of graded difficulty: HOPE's levels normal, complex and extreme.

Numbers are those of HOPE's program (Jiang et al. 2024, arXiv 2405.20579; repository
jiamiya/HOPE, `configs.py` and `env/parking_map_normal.py` of July 2024). One car starts
in an aisle and parks between two obstacles in front of a wall. Sizes are relative to
the car, so that a level exists for any car.

Deviations: HOPE's solid obstacles are quadrilaterals, ours boxes with the same face
towards the bay; its obstacles beyond the aisle have corners moved by up to 0.5 m, ours
are up to 0.5 m longer and wider; and the bay, which reaches 0.1 m beyond the parked car
on all sides, is free of them and of the start.
HOPE counts a car as parked that covers 95 % of the goal; our parked rules apply.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.geometry import box_corners, box_distance, boxes_overlap, move_forward
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.types import Layout, WallKind
from carpark_mj.suite.tpcap import START, TPCAP_CAR

MARGIN = 0.1  # m from the parked car to the nearest obstacle, and to the bay's lines
SOLID = 0.5  # share of the sides with a solid obstacle instead of parked cars
FARTHER = 0.7  # share of the places beyond the next parked car that are taken
WALLED = 0.2  # share of the aisles with a wall opposite instead of scattered boxes
TILT = (math.pi / 36, math.pi / 12)  # rad, of parked cars: deviation and its bound
SETBACK = (0.4, 0.2, 0.8)  # m from the wall behind: mean, deviation and bound
SCATTERED = {"normal": 3, "complex": 5, "extreme": 8}  # boxes beyond the aisle
SCATTER = (2.0, 6.0, 8.0)  # m beyond the aisle: first and last centre, last edge
START_HEADING = math.pi / 6  # rad, deviation from the aisle's direction
START_ROOM = 1.0  # m between the start's rear axle and the aisle's edges
FACE = 0.1  # m, thickness of a solid obstacle's slanted face
WALL = 1.0  # m, thickness of the wall behind the bays
OPPOSITE = 0.1  # m, thickness of the wall opposite
CARS = 4  # on a side of the goal, at most; one less where bays lie along the aisle
# Places of the obstacles that a level can have, beside other and parallel bays: no
# level has all. A side has a solid obstacle of two boxes or cars.
_SIDES = 1 + 2 * (2 + CARS)
_ALL = range(_SIDES + 1 + max(SCATTERED.values()))
_ROWS = np.array([_ALL[:-2], [i for i in _ALL if i not in (2 + CARS, _SIDES - 1)]])
ROUNDING = 2e-3  # m, room for start and bay beyond that: cases may be kept in mm


@dataclasses.dataclass(frozen=True)
class HopeConfig(LayoutConfig):
    """A level of difficulty; lengths [m].

    Attributes:
        level: how much room there is, see `standards.tight_bay`.
        orientation: of the bay to the aisle; `extreme` exists for `parallel` only.
        car: the design car of the case; by default HOPE's and TPCAP's.
    """

    level: standards.Level = "normal"
    orientation: standards.Orientation = "perpendicular"
    car: standards.DesignCar = TPCAP_CAR
    family: str = "hope"
    is_enclosed = False  # cars can leave

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.room

    @property
    def room(self) -> standards.TightBay:
        """The room that the level leaves; an unknown name is a ValueError."""
        return standards.tight_bay(self.orientation, self.level, self.car)

    @property
    def min_bays(self) -> int:
        """One, the goal."""
        return 1

    def split(self) -> tuple[Callable[..., Layout], "_Level"]:
        """All levels share one program."""
        room, along = self.room, self.orientation == "parallel"
        half = 18.0 if along else 15.0
        # How far parked cars can reach from the wall behind them.
        depth = math.hypot(*self.car.size) + SETBACK[2] + MARGIN
        top = depth + room.aisle + SCATTER[2]
        low, high = room.excess
        left = (low if along else high) / 5, high * 4 / 5
        lengths = half, self.car.centre_offset, room.aisle, (top - WALL) / 2
        extent = half + self.car.length, (top + WALL) / 2
        vectors = self.car.size, room.excess, left, extent
        # In double precision where that is enabled, see `held_out`.
        floats = (np.array(x, jnp.result_type(float)) for x in (*lengths, *vectors))
        return _draw_case, _Level(int(along), SCATTERED[self.level], *floats)

    def generate(self, key: jax.Array) -> Layout:
        """Draws a case."""
        return _draw_case(self.split()[1], key)


class _Level(NamedTuple):
    """What levels differ in; lengths [m]."""

    parallel: Any  # whether the bay lies along the aisle, 0 or 1
    scattered: Any  # how many boxes are beyond the aisle
    half_length: Any  # of the wall behind the bays
    offset: Any  # from a car's rear axle to the footprint's centre
    aisle: Any  # width
    middle: Any  # of the lot, above the wall
    size: Any  # (2,) of a car
    excess: Any  # (2,) bounds of the bay's excess length or width
    left: Any  # (2,) bounds of what is left of the goal
    extent: Any  # (2,) half of the lot's


def _draw_case(level: _Level, key: jax.Array) -> Layout:
    """A case; the bay lies below the aisle, which runs along x."""
    room_key, above_key, start_key = jax.random.split(key, 3)
    bay = level.size + 2 * MARGIN
    goal, room = _until(lambda key: _draw_room(level, key), room_key)
    corners = box_corners(room.pose, room.size)[..., 1]
    edge = jnp.max(jnp.where(room.mask[:, None], corners, 0.0)) + MARGIN
    solid = _join(room, _draw_above(level, edge, above_key))
    taken = _join(solid, _Boxes(goal[None], bay[None], jnp.ones(1, bool)))

    def draw_start(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The footprint's centre, anywhere in the aisle near the goal."""
        place_key, yaw_key, back_key = jax.random.split(key, 3)
        share = jax.random.uniform(place_key, (2,), float)
        x = level.half_length / 2 * (2 * share[0] - 1)
        y = edge + START_ROOM + (level.aisle - 2 * START_ROOM) * share[1]
        yaw = _normal([yaw_key], 1, START_HEADING, jnp.pi / 2)[0, 0]
        yaw = yaw + jnp.where(jax.random.bernoulli(back_key), jnp.pi, 0.0)
        pose = move_forward(jnp.stack([x, y, yaw]), level.offset)
        return ~taken.meet(pose, level.size + START + ROUNDING), pose

    start = _until(draw_start, start_key)
    # Along the aisle, the goal faces the way the car starts.
    turned = jnp.where(jnp.cos(start[2]) < 0, level.parallel * jnp.pi, 0.0)
    goal = goal.at[2].add(turned)
    middle = jnp.array([0.0, 1.0, 0.0]) * level.middle
    solid = _Boxes(*(x[jnp.array(_ROWS)[level.parallel]] for x in solid))
    return assemble(
        level.extent,
        bays((goal - middle)[None], bay),
        walls(solid.pose - middle, solid.size, WallKind.ISLAND, solid.mask),
        spawns((start - middle)[None], (START, START), 0.0),
    )


# The levels that HOPE has.
for _level in get_args(standards.Level):
    for _side in get_args(standards.Orientation):
        if (_level, _side) != ("extreme", "perpendicular"):
            register_layout(f"hope_{_level}_{_side}", HopeConfig(_level, _side))


class _Boxes(NamedTuple):
    """Obstacles: poses (n, 3), sizes (n, 2), masks (n,)."""

    pose: jax.Array
    size: jax.Array
    mask: jax.Array

    def meet(self, pose: jax.Array, size: jax.Array) -> jax.Array:
        """() bool, whether a box overlaps any of them."""
        return (boxes_overlap(pose, size, self.pose, self.size) & self.mask).any()


def _until(draw, key: jax.Array):
    """Draws `(valid, value)` from fresh keys until valid; returns the value."""

    @jax.jit  # traced once, for its types and for the loop
    def again(key: jax.Array):
        key, own = jax.random.split(key)
        return key, *draw(own)

    first = jax.eval_shape(again, key)[2]
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), first)
    return jax.lax.while_loop(
        lambda carry: ~carry[1],
        lambda carry: again(carry[0]),
        (key, jnp.zeros((), bool), nothing),
    )[2]


def _join(*parts: _Boxes) -> _Boxes:
    return _Boxes(*(jnp.concatenate(column) for column in zip(*parts, strict=True)))


def _draw(draw: Callable[..., jax.Array], keys: Sequence[jax.Array], count: int):
    """Rows (len(keys), count) of random numbers, one for each key.

    All at once: one call of the generator is one loop, which compiles for long. The
    first numbers of a key are the same for any count.
    """
    # In double precision where that is enabled, see `held_out`.
    return jax.vmap(lambda key: draw(key, (count,), float))(jnp.stack(keys))


def _normal(keys: Sequence[jax.Array], count: int, spread: float, bound: float):
    """Rows (len(keys), count) of normal numbers about 0, clipped."""
    return jnp.clip(spread * _draw(jax.random.normal, keys, count), -bound, bound)


def _stand(level: _Level, x: jax.Array, tilt: jax.Array, setback: jax.Array):
    """Poses (..., 3) of cars with the rear axle at x, so far from the wall at y = 0."""
    yaw = tilt + (1 - level.parallel) * jnp.pi / 2
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    reach = (level.size[0] * jnp.abs(sin) + level.size[1] * jnp.abs(cos)) / 2
    x = x + level.offset * cos
    return jnp.stack([x, reach + MARGIN + setback, yaw], axis=-1)


class _Side(NamedTuple):
    """Random numbers of one side of the goal."""

    solid: jax.Array  # (), uniform, whether there is a solid obstacle
    angle: jax.Array  # (2,) [rad] of the solid obstacle's face
    radius_key: jax.Array  # of its distances
    gap: jax.Array  # (CARS,) uniform, between the cars
    taken: jax.Array  # (CARS,) uniform, whether there is a car
    tilt: jax.Array  # (CARS,) [rad] of the cars
    setback: jax.Array  # () [m] of the cars
    shift: jax.Array  # (CARS,) [m] of each car beyond that


def _draw_numbers(key: jax.Array):
    """Tilt and setback of the goal, and the numbers of both sides."""
    tilt_key, setback_key, *side_keys = jax.random.split(key, 4)
    solid, block, cars = _split(jnp.stack(side_keys), 3)
    angle_keys, radius_keys = _split(block, 2)
    gap, tilt_keys, setback_keys, shift_keys, taken = _split(cars, 5)
    uniform = _draw(jax.random.uniform, [*solid, *gap, *taken], CARS)
    tilt = _normal([tilt_key, *tilt_keys], CARS, *TILT)
    mean, spread, bound = SETBACK
    setback = _draw(jax.random.normal, [setback_key, *setback_keys], 1)[:, 0]
    setback = jnp.clip(mean + spread * setback, 0.0, bound)
    angle = _normal([*angle_keys], 2, math.pi / 24, math.pi / 12)
    shift = _normal([*shift_keys], CARS, 0.05, 0.1)
    solid, gap, taken = uniform[:2, 0], uniform[2:4], uniform[4:]
    columns = solid, angle, radius_keys, gap, taken, tilt[1:], setback[1:], shift
    return tilt[0, 0], setback[0], [_Side(*x) for x in zip(*columns, strict=True)]


def _split(keys: jax.Array, count: int) -> jax.Array:
    """Keys (count, n) of keys (n,)."""
    return jax.vmap(lambda key: jax.random.split(key, count), out_axes=1)(keys)


def _draw_room(level: _Level, key: jax.Array):
    """The goal and its surroundings: (whether it is a case, (goal, boxes))."""
    tilt, setback, sides = _draw_numbers(key)
    low, high = level.excess
    goal = _stand(level, jnp.zeros(()), tilt, setback)
    left = _draw_side(level, goal, -1, level.left, sides[0])

    def gap(side: _Boxes) -> jax.Array:
        away = box_distance(goal, level.size, side.pose, side.size)
        return jnp.where(side.mask, away, jnp.inf).min()

    at_left = gap(left)
    rest = jnp.maximum(level.excess - at_left, 0.0) + MARGIN
    right = _draw_side(level, goal, 1, rest, sides[1])
    at_right = gap(right)
    behind = _Boxes(
        jnp.array([[0.0, -WALL / 2, 0.0]]),
        jnp.array([[2 * level.half_length, WALL]]),
        jnp.ones(1, bool),
    )
    room = _join(behind, left, right)
    total = at_left + at_right
    bay = level.size + 2 * MARGIN + ROUNDING
    valid = (total >= low) & (total <= high) & ~room.meet(goal, bay)
    return valid & (jnp.minimum(at_left, at_right) >= MARGIN), (goal, room)


def _draw_side(
    level: _Level, goal: jax.Array, way: int, gap: jax.Array, side: _Side
) -> _Boxes:
    """Obstacles left (way -1) or right (1) of the goal, at a gap from a range."""
    solid = side.solid < SOLID
    block = _draw_block(level, goal, way, gap, side)
    cars = _draw_cars(level, way, gap, side)
    block = block._replace(mask=block.mask & solid)
    return _join(block, cars._replace(mask=cars.mask & ~solid))


def _draw_block(level, goal, way, gap, side: _Side) -> _Boxes:
    """A solid obstacle: a slanted face, and a box from there to the wall's end."""
    # The goal's corners on this side, the one at the aisle first.
    picks = (((0, 1), (1, 2)), ((3, 2), (0, 3)))[way > 0]
    corner = box_corners(goal, level.size)[jnp.array(picks)[level.parallel]]
    low, high = gap
    spread = jax.random.normal(side.radius_key, (2,), float) * (high - low) / 4
    radius = jnp.clip((low + high) / 2 + spread, low, high)
    step = jnp.stack([way * jnp.cos(side.angle), jnp.sin(side.angle)], axis=-1)
    top, bottom = corner + radius[:, None] * step
    along = top - bottom
    length = jnp.linalg.norm(along)
    outwards = way * jnp.array([along[1], -along[0]]) / length
    middle = (top + bottom + FACE * outwards) / 2
    face = jnp.append(middle, jnp.arctan2(along[1], along[0]))
    inner = jnp.maximum(way * top[0], way * bottom[0])
    width = jnp.maximum(level.half_length - inner, FACE)
    box = jnp.stack([way * (inner + width / 2), top[1] / 2, jnp.zeros_like(width)])
    size = jnp.array([[length, FACE], [width, top[1]]])
    return _Boxes(jnp.stack([face, box]), size, jnp.ones(2, bool))


def _draw_cars(level, way, gap, side: _Side) -> _Boxes:
    """Parked cars: one next to the goal, perhaps others beyond it."""
    pitch = level.size[1 - level.parallel]
    low, high = gap
    gaps = low + (high - low) * side.gap
    gaps = gaps + MARGIN * (jnp.arange(CARS) > 0)
    shift = side.shift.at[0].set(0.0)
    x, setback = way * jnp.cumsum(pitch + gaps), side.setback + jnp.cumsum(shift)
    pose = _stand(level, x, side.tilt, setback)
    taken = (side.taken < FARTHER).at[0].set(True)
    taken = taken & (jnp.arange(CARS) < CARS - level.parallel)
    return _Boxes(pose, jnp.broadcast_to(level.size, (CARS, 2)), taken)


def _draw_above(level: _Level, edge: jax.Array, key: jax.Array) -> _Boxes:
    """Obstacles beyond the aisle, whose near edge is at y = `edge`."""
    count, far = max(SCATTERED.values()), edge + level.aisle
    keys = [*jax.random.split(key, 4)]
    wall, share, turn, larger = _draw(jax.random.uniform, keys, 2 * count)
    walled = wall[0] < WALLED
    half, (first, last, end) = level.half_length, SCATTER
    wall = jnp.array([[0.0, MARGIN + OPPOSITE / 2, 0.0]]) + far * jnp.array([0, 1, 0])
    wall = _Boxes(wall, jnp.array([[2 * half, OPPOSITE]]), walled[None])
    share = share.reshape(count, 2)
    x = (half - 2.0) * (2 * share[:, 0] - 1)
    y = far + first + (last - first) * share[:, 1]
    yaw = 2 * jnp.pi * turn[:count]
    pose = jnp.stack([x, y, yaw], axis=-1)
    size = level.size + 0.5 * larger.reshape(count, 2)
    corners = box_corners(pose, size)
    inside = (jnp.abs(corners[..., 0]) <= half) & (corners[..., 1] >= far)
    mask = (inside & (corners[..., 1] <= far + end)).all(axis=1)
    mask = mask & (jnp.arange(count) < level.scattered)
    meets = boxes_overlap(pose[:, None], size[:, None], pose, size)

    def keep(row: jax.Array, stays: jax.Array) -> jax.Array:
        return stays.at[row].set(mask[row] & ~(meets[row] & stays).any())

    # Those drawn first stay.
    stays = jax.lax.fori_loop(0, count, keep, jnp.zeros(count, bool))
    return _join(wall, _Boxes(pose, size, stays & ~walled))
