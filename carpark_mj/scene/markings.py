"""Paint on the asphalt: bay lines and numbers, and arrows along one-way lanes."""

import math
from typing import Any

import mujoco
import numpy as np
import trimesh

from carpark_mj.layouts import types as paint
from carpark_mj.layouts.types import Layout
from carpark_mj.scene import looks
from carpark_mj.scene.cameras import view_yaw
from carpark_mj.scene.car_mesh import add_mesh, merge
from carpark_mj.scene.parts import yaw_quat


def _paint(
    spec: mujoco.MjSpec, name: str, pose: Any, along: float, aside: float, **shape: Any
) -> None:
    """Adds paint at a place in the frame of a pose (3,) [m, m, rad]."""
    x, y, yaw = map(float, pose)
    cos, sin = math.cos(yaw), math.sin(yaw)
    place = [x + cos * along - sin * aside, y + sin * along + cos * aside, 0.0]
    fields = shape | looks.PAINT
    spec.worldbody.add_geom(name=name, pos=place, quat=yaw_quat(yaw), **fields)


_BOX = mujoco.mjtGeom.mjGEOM_BOX


def _mesh(name: str) -> dict[str, Any]:
    return {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name}


def add_bay_lines(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints both long sides of every bay and its far end."""
    for bay in np.flatnonzero(np.asarray(layout.bay_mask)):
        length, width = np.asarray(layout.bay_size[bay], float)
        half = paint.LINE_WIDTH / 2
        for name, dx, dy, *size in (
            ("left", 0.0, width / 2, length / 2, half),
            ("right", 0.0, -width / 2, length / 2, half),
            ("end", -length / 2 + half, 0.0, half, width / 2),
        ):
            shape = {"type": _BOX, "size": [*size, paint.LINE_HEIGHT]}
            _paint(spec, f"bay{bay}/{name}", layout.bay_pose[bay], dx, dy, **shape)


def add_lane_arrows(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints arrows of travel on every one-way lane."""
    rows = np.flatnonzero(np.asarray(layout.lane_mask & layout.lane_one_way))
    if not rows.size:
        return
    length, width = paint.ARROW_LENGTH, paint.ARROW_WIDTH
    half, head = length / 2, length * paint.ARROW_HEAD
    high = paint.ARROW_HEIGHT  # as deep under the ground
    shaft = trimesh.creation.box((length - head, width * paint.ARROW_SHAFT, 2 * high))
    shaft.apply_translation((-head / 2, 0.0, 0.0))
    corners = [(half, 0.0), (half - head, width / 2), (half - head, -width / 2)]
    tip = trimesh.convex.convex_hull(
        np.array([(x, y, z) for x, y in corners for z in (-high, high)])
    )
    add_mesh(spec, "arrow", merge([shaft, tip]))
    for lane in rows:
        pose, length = layout.lane_pose[lane], float(layout.lane_size[lane, 0])
        count = max(int(length / paint.ARROW_SPACING), 1)
        for k in range(count):
            along = ((k + 0.5) / count - 0.5) * length
            _paint(spec, f"lane{lane}/arrow{k}", pose, along, 0.0, **_mesh("arrow"))


HEIGHT, WIDTH = 0.42, 0.24  # m, of a digit
STROKE = 0.06  # m
SPACING = 0.32  # m, from digit to digit
THICKNESS = 0.008  # m
EDGE_DISTANCE = 0.30  # m, from the open end of the bay to the middle of its number

# Segments at points in units of a digit's half width and half height; those with x = 0
# are horizontal.
_SEGMENTS = {
    "a": (0, 1),
    "b": (1, 0.5),
    "c": (1, -0.5),
    "d": (0, -1),
    "e": (-1, -0.5),
    "f": (-1, 0.5),
    "g": (0, 0),
}
_DIGITS = (
    *("abcdef", "bc", "abged", "abgcd", "fgbc"),
    *("afgcd", "afgedc", "abc", "abcdefg", "abcdfg"),
)


def digit_mesh(digit: int) -> trimesh.Trimesh:
    """One digit in the xy-plane, upright along +y, centred on the origin."""
    strokes = []
    for name in _DIGITS[digit]:
        x, y = _SEGMENTS[name]
        extent = (STROKE, HEIGHT / 2) if x else (WIDTH, STROKE)
        stroke = trimesh.creation.box((*extent, THICKNESS))
        at = (x * (WIDTH - STROKE) / 2, y * (HEIGHT - STROKE) / 2, 0.0)
        strokes.append(stroke.apply_translation(at))
    return merge(strokes)


def add_bay_numbers(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints every bay's index at its open end, upright for the lot's cameras."""
    right = view_yaw(np.asarray(layout.extent, float))
    for digit in range(10):
        add_mesh(spec, f"digit{digit}", digit_mesh(digit))
    for bay in np.flatnonzero(np.asarray(layout.bay_mask)):
        x, y, yaw = np.asarray(layout.bay_pose[bay], float)
        reach = float(layout.bay_size[bay, 0]) / 2 - EDGE_DISTANCE
        x, y = x + reach * math.cos(yaw), y + reach * math.sin(yaw)
        turn = yaw + math.pi / 2  # read from the aisle
        if math.cos(turn - right) < -1e-3:  # upside down
            turn += math.pi
        text = str(bay)
        for place, digit in enumerate(text):
            along = (place - (len(text) - 1) / 2) * SPACING
            name, shape = f"bay{bay}/digit{place}", _mesh(f"digit{digit}")
            _paint(spec, name, (x, y, turn), along, 0.0, **shape)
