"""Assembles a layout from groups of rows; the last step of every generator.

A group is a dictionary of `Layout` fields with one leading dimension. Arguments
broadcast against the poses and leading dimensions are flattened. In the layout masked
rows are zeros.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import IntRange, Range
from carpark_mj.geometry import swept_half_size, wrap_angle
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import BayEnd, BayKind, DiscKind, Layout, WallKind

# Largest deviation of a spawning car's heading from its lane's [rad].
LANE_SPREAD = 0.1

Group = dict[str, jax.Array]
# Trailing shapes and types of the fields of rows.
PARTS: dict[str, tuple[tuple[int, ...], Any]] = {
    "pose": ((3,), jnp.float32),
    "size": ((2,), jnp.float32),
    "centre": ((2,), jnp.float32),
    "radius": ((), jnp.float32),
    "spread": ((), jnp.float32),
    "kind": ((), jnp.int32),
    "end": ((), jnp.int32),
    "one_way": ((), jnp.bool_),
    "mask": ((), jnp.bool_),
}


def chances(key: jax.Array, count: int) -> jax.Array:
    """(count,) uniform in [0, 1), for all of a lot: each call costs compile time."""
    return jax.random.uniform(key, (count,), jnp.float32)


def draw(chance: jax.Array, bounds: Range) -> jax.Array:
    """A float32 () uniform over a range."""
    low, high = bounds
    return low + (high - low) * chance


def draw_int(chance: jax.Array, bounds: IntRange) -> jax.Array:
    """An int32 () uniform over a range, both ends included."""
    low, high = bounds
    step = jnp.floor((high - low + 1) * chance).astype(jnp.int32)
    return jnp.minimum(low + step, high)


def require_least(config: Any, least: float, name: str) -> None:
    """Refuses a range of a config that reaches below what its car needs [m]."""
    if (value := getattr(config, name))[0] < least:
        needed = f"at least {least:.2f} m for the car"
        raise ValueError(f"{name} must be {needed}, not {value}")


def require_aisle(aisle: float, least: float) -> None:
    """Refuses an aisle that is too narrow for the car to drive, spawn and turn in."""
    if aisle < least:
        raise ValueError(
            f"the aisle must be at least {least:.2f} m for the car to turn into a "
            f"bay (carpark_mj.layouts.standards), not {aisle:g}"
        )


def stacked(*columns: Any) -> jax.Array:
    """Poses or sizes (..., n) of columns (...) that broadcast against each other."""
    return jnp.stack(jnp.broadcast_arrays(*columns), axis=-1)


def row_depth(width: jax.Array, length: jax.Array, angle: jax.Array) -> jax.Array:
    """Depth [m] of a row of bays, from the aisle's edge to its far corners."""
    return length * jnp.sin(angle) + width * jnp.cos(angle)


def _rows(row: str, mask: Any, **values: Any) -> Group:
    """A group of one kind of row; its values broadcast against the places.

    Masks that are known stay with NumPy, see `assemble`. Other constants do not: a
    mixture under `jax.vmap` would select each of them for each of its members.
    """
    lead = np.shape(values["pose" if "pose" in values else "centre"])[:-1]
    group = {}
    for part, value in (values | {"mask": mask}).items():
        trailing, dtype = PARTS[part]
        use: Any = jnp if part != "mask" or isinstance(value, jax.Array) else np
        value = use.broadcast_to(use.asarray(value, dtype), (*lead, *trailing))
        group[f"{row}_{part}"] = value.reshape(-1, *trailing)
    return group


def bays(
    pose: Any,
    size: Any,
    kind: Any = BayKind.STANDARD,
    mask: Any = True,
    end: Any = BayEnd.EITHER,
) -> Group:
    """Bays (..., 3), (..., 2); `kind` and `end` are a `BayKind` and a `BayEnd` each."""
    # Layouts have no ends if either is known to be allowed everywhere.
    some = isinstance(end, jax.Array) or np.any(end)
    ends = {"end": end} if some else {}
    return _rows("bay", mask, pose=pose, size=size, kind=kind, **ends)


def walls(pose: Any, size: Any, kind: Any = WallKind.WALL, mask: Any = True) -> Group:
    """Walls and other solid boxes (..., 3), (..., 2)."""
    return _rows("wall", mask, pose=pose, size=size, kind=kind)


def discs(
    centre: Any, radius: Any, kind: Any = DiscKind.PILLAR, mask: Any = True
) -> Group:
    """Pillars or bollards (..., 2), (...)."""
    return _rows("disc", mask, centre=centre, radius=radius, kind=kind)


def lanes(pose: Any, size: Any, one_way: Any = True, mask: Any = True) -> Group:
    """Lanes (..., 3), (..., 2)."""
    return _rows("lane", mask, pose=pose, size=size, one_way=one_way)


def spawns(pose: Any, size: Any, spread: Any, mask: Any = True) -> Group:
    """Spawn regions (..., 3), (..., 2)."""
    return _rows("spawn", mask, pose=pose, size=size, spread=spread)


def spawns_in(car: DesignCar, pose: Any, size: Any, mask: Any = True) -> Group:
    """Spawn regions in which a car stays within rectangles (..., 3), (..., 2)."""
    reach = swept_half_size(jnp.array(car.size), jnp.array(LANE_SPREAD))
    return spawns(pose, jnp.asarray(size) - 2 * reach, LANE_SPREAD, mask)


def driven_lanes(
    car: DesignCar, pose: Any, size: Any, mask: Any = True
) -> tuple[Group, Group]:
    """Lanes (..., 3), (..., 2), and the spawn regions of a car in them."""
    return lanes(pose, size, mask=mask), spawns_in(car, pose, size, mask)


def swept_size(car: DesignCar) -> tuple[float, float]:
    """Length and width [m] of the ground of a car that spawns in a lane."""
    # `swept_half_size` of a small spread, without JAX: configs must not start it.
    cos, sin = math.cos(LANE_SPREAD), math.sin(LANE_SPREAD)
    return car.length * cos + car.width * sin, car.width * cos + car.length * sin


def least_lane(car: DesignCar) -> float:
    """Narrowest lane [m] in which a car can spawn, with a margin of 5 cm."""
    return swept_size(car)[1] + 0.05


def two_lanes(pose: Any, size: Any) -> tuple[jax.Array, jax.Array]:
    """Splits two-way aisles (..., 3), (..., 2) into lanes (..., 2, 3), (..., 2, 2).

    Traffic keeps to the right; the first lane runs along the aisle's heading.
    """
    pose, size = jnp.asarray(pose, jnp.float32), jnp.asarray(size, jnp.float32)
    x, y, yaw = jnp.unstack(pose[..., None], axis=-2)
    aside = size[..., 1:] / 4 * jnp.array([-1.0, 1.0])
    x, y = x - jnp.sin(yaw) * aside, y + jnp.cos(yaw) * aside
    lane = size * jnp.array([1.0, 0.5])
    lane = jnp.broadcast_to(lane[..., None, :], (*lane.shape[:-1], 2, 2))
    return stacked(x, y, yaw + jnp.array([0.0, jnp.pi])), lane


def boundary(half_x: Any, half_y: Any, thickness: float, kind: WallKind) -> Group:
    """Four walls around a rectangle whose inner faces are at +-half_x and +-half_y."""
    half_x, half_y = jnp.float32(half_x), jnp.float32(half_y)
    x = jnp.array([0.0, 0.0, -1.0, 1.0]) * (half_x + thickness / 2)
    y = jnp.array([-1.0, 1.0, 0.0, 0.0]) * (half_y + thickness / 2)
    across = stacked(2 * (half_x + thickness), thickness)
    along = stacked(thickness, 2 * half_y)
    return walls(stacked(x, y, 0.0), jnp.stack([across, across, along, along]), kind)


def assemble(extent: Any, *groups: Group) -> Layout:
    """Joins groups of rows, in their order, into a layout of an extent (2,) [m]."""
    columns: dict[str, list[Any]] = {}
    ends = any("bay_end" in group for group in groups)
    none, size = np.zeros((0, 3)), np.zeros(2)
    empty = [  # so that every field exists
        *(bays(none, size), walls(none, size), discs(none[:, :2], 0.0)),
        *(lanes(none, size), spawns(none, size, 0.0)),
    ]
    for group in (*empty, *groups):
        if ends and "bay_mask" in group:
            either = jnp.full(group["bay_mask"].shape, BayEnd.EITHER, jnp.int32)
            group = {"bay_end": either} | group
        for name, rows in group.items():
            columns.setdefault(name, []).append(rows)
    fields: dict[str, jax.Array] = {}
    full: set[str] = set()  # kinds of rows of which none is masked
    for name in [name for name in columns if name.endswith("_mask")]:
        masks = columns.pop(name)
        if all(isinstance(mask, np.ndarray) and mask.all() for mask in masks):
            full.add(name)
            fields[name] = jnp.ones(sum(map(len, masks)), bool)
        else:
            fields[name] = jnp.concatenate(masks)
    for name, rows in columns.items():
        row, _, part = name.partition("_")
        value = jnp.concatenate([x for x in rows if len(x)] or rows[:1])
        if part == "pose":
            value = jnp.where(np.arange(3) == 2, wrap_angle(value), value)
        if (mask := f"{row}_mask") not in full:
            keep = jnp.expand_dims(fields[mask], range(1, value.ndim))
            value = jnp.where(keep, value, jnp.zeros((), value.dtype))
        fields[name] = value
    return Layout(**fields, extent=jnp.asarray(extent, jnp.float32))


@jax.jit  # many small operations would each be compiled on their own
def from_columns(extent: Any, columns: dict[str, dict[str, Any]]) -> Layout:
    """Makes a layout of arguments of `bays`, `walls`, `discs`, `lanes` and `spawns`."""
    makers = {make.__name__: make for make in (bays, walls, discs, lanes, spawns)}
    groups = [make(**columns[x]) for x, make in makers.items() if x in columns]
    return assemble(extent, *groups)
