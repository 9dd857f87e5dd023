"""How people, carts and other movers look: mocap bodies of simple shapes.

A mover has one solid shape, hidden, with which cars collide: an upright cylinder or a
box. What is seen of it are capsules, boxes and cylinders on the same body; a person's
legs are two more bodies, which swing about the hips.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind
from carpark_mj.layouts.types import MOVER_HEIGHTS
from carpark_mj.scene import looks
from carpark_mj.scene.parts import COLLIDES, HIDDEN, HULL_GROUP, yaw_quat

LONGER_IS_CAR = 3.0  # m
RADIUS = 0.3  # m, of the person whose measures are below; others are scaled
HIP, HIP_Y = 0.85, 0.09  # m
LEGS = (1.0, -1.0)  # sides; they swing against each other
STRIDE, SWING = 1.4, 0.45  # m of two steps, and the largest angle [rad] [est]
_BOX, _CAPSULE = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CAPSULE
_CYLINDER, _BALL = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE
_AXLE = [math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0]  # a cylinder along y


class Part(NamedTuple):
    """A geom; of boxes x and y are shares of the half length and width."""

    shape: Any
    pos: tuple[float, float, float]
    size: tuple[float, float, float]
    colour: looks.Colour
    quat: Sequence[float] = (1.0, 0.0, 0.0, 0.0)


def _wheels(x: float, y: float, radius: float, width: float) -> list[Part]:
    return [
        Part(_CYLINDER, (i * x, j * y, radius), (radius, width, 0), looks.TYRE, _AXLE)
        for i in (-1, 1)
        for j in (-1, 1)
    ]


_LEG = Part(_CAPSULE, (0, 0, -0.41), (0.08, 0.35, 0), looks.TROUSERS)
_CART = [
    Part(_BOX, (0, 0, 0.2), (1.0, 1.0, 0.03), looks.TRIM),
    Part(_BOX, (0.1, 0, 0.62), (0.85, 0.95, 0.3), looks.MOVER),
    Part(_BOX, (-0.95, 0, 1.0), (0.05, 0.95, 0.03), looks.TRIM),
    *_wheels(0.8, 0.85, 0.09, 0.03),
]
_CAR = [
    Part(_BOX, (0, 0, 0.55), (1.0, 1.0, 0.33), looks.MOVER),
    Part(_BOX, (-0.08, 0, 1.13), (0.5, 0.85, 0.27), looks.GLASS),
    Part(_BOX, (-0.08, 0, 1.41), (0.45, 0.82, 0.02), looks.MOVER),
    *_wheels(0.6, 0.9, 0.31, 0.11),
]


def _person(number: int) -> list[Part]:
    coat = looks.COATS[number % len(looks.COATS)]
    return [
        Part(_CAPSULE, (0, 0, 1.12), (0.17, 0.19, 0), coat),
        Part(_BALL, (0, 0, 1.58), (0.12, 0, 0), looks.SKIN),
        Part(_CAPSULE, (0, 0.24, 1.08), (0.055, 0.24, 0), coat),
        Part(_CAPSULE, (0, -0.24, 1.08), (0.055, 0.24, 0), coat),
    ]


class Shape(NamedTuple):
    """A mover and its size."""

    parts: list[Part]  # what is seen of it
    solid: Part  # with which cars collide, in metres
    scale: np.ndarray  # (3,) of the parts' x, y and z
    is_person: bool  # whether it has legs


def _solid(group: Group, size: np.ndarray) -> Part:
    """The solid of an obstacle of a size, (2,) of boxes and () of discs [m]."""
    half = MOVER_HEIGHTS[type(group)] / 2
    if isinstance(group, Boxes):
        return Part(_BOX, (0, 0, half), (*size / 2, half), looks.MOVER)
    return Part(_CYLINDER, (0, 0, half), (float(size), half, 0), looks.MOVER)


def _shape(group: Group, row: int, number: int) -> Shape:
    size = np.asarray(group.size, float)[row]
    solid = _solid(group, size)
    if isinstance(group, Boxes):
        parts = _CAR if size[0] > LONGER_IS_CAR else _CART
        return Shape(parts, solid, np.array([*size / 2, 1.0]), False)
    if group.kind == ObstacleKind.PERSON:
        return Shape(_person(number), solid, np.full(3, size / RADIUS), True)
    return Shape([solid], solid, np.ones(3), False)


def _rows(groups: Sequence[Group]) -> Iterator[tuple[int, Group, int]]:
    """Numbers of movers, their groups and rows."""
    pairs = ((group, row) for group in groups for row in range(group.count))
    for number, (group, row) in enumerate(pairs):
        yield number, group, row


def add_movers(spec: mujoco.MjSpec, groups: Sequence[Group]) -> None:
    """Bodies `mover0`... for every obstacle of some groups, and `mover0/leg0`...

    They are kinematic: contacts do not move them, and they push cars.
    """
    for number, group, row in _rows(groups):
        shape, name = _shape(group, row, number), f"mover{number}"
        body = spec.worldbody.add_body(name=name, mocap=True)
        _add_geom(body, shape.solid, np.ones(3), name, group=HULL_GROUP, **COLLIDES)
        for part in shape.parts:
            _add_geom(body, part, shape.scale)
        if shape.is_person:
            for side in range(len(LEGS)):
                leg = spec.worldbody.add_body(name=f"{name}/leg{side}", mocap=True)
                _add_geom(leg, _LEG, shape.scale)
    for name, (pos, quat) in Walkers().places(groups).items():
        body = spec.body(name)
        body.pos, body.quat = pos, quat


def add_solids(
    spec: mujoco.MjSpec, groups: Sequence[Group], hulls: Sequence[str]
) -> None:
    """Bodies `mover0`... of the solids alone, which only the geoms `hulls` touch.

    So the door of a parked car and people between two of them do not push these. Groups
    may have shapes instead of arrays; their sizes are set later.
    """
    slide, spin, roll = COLLIDES["friction"]
    for number, group, _ in _rows(groups):
        name, solid = f"mover{number}", _solid(group, np.ones(group.size.shape[1:]))
        body = spec.worldbody.add_body(name=name, mocap=True)
        still = looks.VISUAL | {"group": HULL_GROUP}
        _add_geom(body, solid, np.ones(3), name, **still)
        for hull in hulls:
            pair = spec.add_pair(geomname1=name, geomname2=hull, condim=3)
            pair.friction = [slide, slide, spin, roll, roll]
            pair.solref = COLLIDES["solref"]


def _add_geom(
    body: Any, part: Part, scale: np.ndarray, name: str = "", **fields: Any
) -> None:
    # Round parts keep round: what is scaled of carts' wheels is their place.
    grown = scale if part.shape == _BOX else scale[2]
    body.add_geom(
        name=name,
        type=part.shape,
        pos=np.array(part.pos) * scale,
        quat=part.quat,
        size=np.array(part.size) * grown,
        rgba=part.colour,
        **(fields or looks.VISUAL),
    )


class Walkers:
    """Where movers' bodies are, frame by frame: legs swing with the way walked."""

    def __init__(self) -> None:
        """Nobody has walked yet."""
        # Where movers have last been, their headings, and how far they have walked.
        self._last: dict[int, tuple[np.ndarray, float, float]] = {}

    def places(self, groups: Sequence[Group]) -> dict[str, tuple[Any, Any]]:
        """Positions and quaternions of bodies by name; below the ground if absent."""
        found: dict[str, tuple[Any, Any]] = {}
        for number, group, row in _rows(groups):
            shape, name = _shape(group, row, number), f"mover{number}"
            pose = np.asarray(group.pose_w, float)[row]
            here = group.mask is None or bool(np.asarray(group.mask)[row])
            xy, z = pose[:2], 0.0 if here else HIDDEN
            swing, yaw = self._walk(number, xy)
            yaw = pose[2] if pose.size > 2 else yaw
            found[name] = [*xy, z], yaw_quat(yaw)
            if not shape.is_person:
                continue
            for side, sign in enumerate(LEGS):
                out, up = HIP_Y * shape.scale[2] * sign, z + HIP * shape.scale[2]
                hip = [xy[0] - out * math.sin(yaw), xy[1] + out * math.cos(yaw), up]
                found[f"{name}/leg{side}"] = hip, yaw_quat(yaw, sign * swing)
        return found

    def _walk(self, number: int, xy: np.ndarray) -> tuple[float, float]:
        """The angle of the legs and the heading [rad] of a mover."""
        last, yaw, walked = self._last.get(number, (xy, 0.0, 0.0))
        dx, dy = xy - last
        way = math.hypot(dx, dy)
        walks = 1e-3 < way < 1.0  # else it stands, or is somewhere else at once
        yaw = math.atan2(dy, dx) if walks else yaw
        walked = walked + way if walks else 0.0
        self._last[number] = xy, yaw, walked
        return SWING * math.sin(2 * math.pi * walked / STRIDE), yaw
