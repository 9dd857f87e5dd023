"""Assembles a layout from groups of rows; the last step of every generator.

A group is a dictionary of `Layout` fields with one leading dimension. Arguments
broadcast against the poses, leading dimensions are flattened, and masked rows become
zeros.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.geometry import swept_half_size, wrap_angle
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import BayEnd, BayKind, DiscKind, Layout, WallKind

Group = dict[str, jax.Array]

# Largest deviation of a spawning car's heading from its lane's [rad].
LANE_SPREAD = 0.1


def _rows(
    row: str, lead: tuple[int, ...], counts: Any, /, **parts: tuple[Any, Any, Any]
) -> Group:
    """A group of one kind of row; parts are (value, trailing shape, dtype)."""
    mask = jnp.broadcast_to(jnp.asarray(counts, bool), lead).reshape(-1)
    group = {f"{row}_mask": mask}
    for name, (value, trailing, dtype) in parts.items():
        value = jnp.broadcast_to(jnp.asarray(value, dtype), (*lead, *trailing))
        value = value.reshape(-1, *trailing)
        keep = mask.reshape(-1, *([1] * len(trailing)))
        group[f"{row}_{name}"] = jnp.where(keep, value, jnp.zeros_like(value))
    return group


def _pose(pose: Any) -> jax.Array:
    pose = jnp.asarray(pose, jnp.float32)
    return pose.at[..., 2].set(wrap_angle(pose[..., 2]))


def bays(
    pose: Any,
    size: Any,
    kind: Any = BayKind.STANDARD,
    mask: Any = True,
    end: Any = BayEnd.EITHER,
) -> Group:
    """Bays (..., 3), (..., 2); `kind` and `end` are a `BayKind` and a `BayEnd` each."""
    pose = _pose(pose)
    return _rows(
        "bay",
        pose.shape[:-1],
        mask,
        pose=(pose, (3,), jnp.float32),
        size=(size, (2,), jnp.float32),
        kind=(kind, (), jnp.int32),
        **_ends(end),
    )


def _ends(end: Any) -> dict[str, tuple[Any, Any, Any]]:
    """The field of `bays`; empty if either end is known to be allowed."""
    either = not isinstance(end, jax.Array) and not np.any(end)
    return {} if either else {"end": (end, (), jnp.int32)}


def walls(pose: Any, size: Any, kind: Any = WallKind.WALL, mask: Any = True) -> Group:
    """Walls and other solid boxes (..., 3), (..., 2)."""
    pose = _pose(pose)
    return _rows(
        "wall",
        pose.shape[:-1],
        mask,
        pose=(pose, (3,), jnp.float32),
        size=(size, (2,), jnp.float32),
        kind=(kind, (), jnp.int32),
    )


def discs(
    centre: Any, radius: Any, kind: Any = DiscKind.PILLAR, mask: Any = True
) -> Group:
    """Pillars or bollards (..., 2), (...)."""
    centre = jnp.asarray(centre, jnp.float32)
    return _rows(
        "disc",
        centre.shape[:-1],
        mask,
        centre=(centre, (2,), jnp.float32),
        radius=(radius, (), jnp.float32),
        kind=(kind, (), jnp.int32),
    )


def lanes(pose: Any, size: Any, one_way: Any = True, mask: Any = True) -> Group:
    """Lanes (..., 3), (..., 2)."""
    pose = _pose(pose)
    return _rows(
        "lane",
        pose.shape[:-1],
        mask,
        pose=(pose, (3,), jnp.float32),
        size=(size, (2,), jnp.float32),
        one_way=(one_way, (), bool),
    )


def spawns(pose: Any, size: Any, spread: Any, mask: Any = True) -> Group:
    """Spawn regions (..., 3), (..., 2)."""
    pose = _pose(pose)
    return _rows(
        "spawn",
        pose.shape[:-1],
        mask,
        pose=(pose, (3,), jnp.float32),
        size=(size, (2,), jnp.float32),
        spread=(spread, (), jnp.float32),
    )


def spawns_in(car: DesignCar, pose: Any, size: Any, mask: Any = True) -> Group:
    """Spawn regions that keep a car within free rectangles (..., 3), (..., 2).

    Headings deviate from the rectangles' by at most `LANE_SPREAD`.
    """
    reach = swept_half_size(jnp.array(car.size), jnp.array(LANE_SPREAD))
    return spawns(pose, jnp.asarray(size) - 2 * reach, LANE_SPREAD, mask)


def least_lane(car: DesignCar) -> float:
    """Narrowest lane [m] in which a car can spawn, with a margin of 5 cm."""
    # `swept_half_size` of a small spread, without JAX: configs must not start it.
    reach = car.width * math.cos(LANE_SPREAD) + car.length * math.sin(LANE_SPREAD)
    return reach + 0.05


def two_lanes(pose: Any, size: Any) -> tuple[jax.Array, jax.Array]:
    """Splits two-way aisles (..., 3), (..., 2) into lanes (..., 2, 3), (..., 2, 2).

    Traffic keeps to the right: the first lane runs along the aisle's heading, on its
    right half, the second against it.
    """
    pose, size = jnp.asarray(pose, jnp.float32), jnp.asarray(size, jnp.float32)
    x, y, yaw = pose[..., 0], pose[..., 1], pose[..., 2]
    aside = size[..., 1] / 4
    right = jnp.stack([jnp.sin(yaw), -jnp.cos(yaw)], axis=-1) * aside[..., None]
    centre = jnp.stack([x, y], axis=-1)
    there = jnp.concatenate([centre + right, yaw[..., None]], axis=-1)
    back = jnp.concatenate([centre - right, yaw[..., None] + jnp.pi], axis=-1)
    lane = size * jnp.array([1.0, 0.5])
    return jnp.stack([there, back], axis=-2), jnp.stack([lane, lane], axis=-2)


def boundary(half_x: Any, half_y: Any, thickness: float, kind: WallKind) -> Group:
    """Four walls around a rectangle whose inner faces are at +-half_x and +-half_y."""
    half_x, half_y = jnp.float32(half_x), jnp.float32(half_y)
    zero, off = jnp.zeros_like(half_x), thickness / 2
    poses = [
        (zero, -half_y - off, zero),
        (zero, half_y + off, zero),
        (-half_x - off, zero, zero),
        (half_x + off, zero, zero),
    ]
    across = (2 * (half_x + thickness), zero + thickness)
    along = (zero + thickness, 2 * half_y)
    return walls(
        jnp.stack([jnp.stack(pose) for pose in poses]),
        jnp.stack([jnp.stack(size) for size in (across, across, along, along)]),
        kind,
    )


def _empty() -> list[Group]:
    """A group of no rows of every kind, so that every field exists."""
    pose, size = jnp.zeros((0, 3)), jnp.zeros(2)
    return [
        bays(pose, size),
        walls(pose, size),
        discs(pose[:, :2], 0.0),
        lanes(pose, size),
        spawns(pose, size, 0.0),
    ]


def assemble(extent: Any, *groups: Group) -> Layout:
    """Joins groups of rows into a layout.

    Args:
        extent: (2,) half widths of the lot in x and y [m].
        groups: in any order; rows of a kind keep the order of their groups.
    """
    columns: dict[str, list[jax.Array]] = {}
    ends = any("bay_end" in group for group in groups)
    for group in (*_empty(), *groups):
        if ends and "bay_mask" in group:
            either = jnp.full(group["bay_mask"].shape, BayEnd.EITHER, jnp.int32)
            group = {"bay_end": either} | group
        for name, rows in group.items():
            columns.setdefault(name, []).append(rows)
    fields = {name: jnp.concatenate(rows) for name, rows in columns.items()}
    return Layout(**fields, extent=jnp.asarray(extent, jnp.float32))


@jax.jit  # many small operations would each be compiled on their own
def from_columns(extent: Any, columns: dict[str, dict[str, Any]]) -> Layout:
    """Makes a layout of the columns of its rows.

    Args:
        extent: see `assemble`.
        columns: arguments of `bays`, `walls`, `discs`, `lanes` and `spawns` by name.
    """
    make = {
        "bays": bays,
        "walls": walls,
        "discs": discs,
        "lanes": lanes,
        "spawns": spawns,
    }
    groups = [make[rows](**columns[rows]) for rows in make if rows in columns]
    return assemble(extent, *groups)
