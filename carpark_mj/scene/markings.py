"""Paint on the asphalt: bay lines, and arrows along one-way lanes."""

import math

import mujoco
import numpy as np
import trimesh

from carpark_mj.layouts.types import (
    ARROW_HEAD,
    ARROW_HEIGHT,
    ARROW_LENGTH,
    ARROW_SHAFT,
    ARROW_SPACING,
    ARROW_WIDTH,
    LINE_HEIGHT,
    LINE_WIDTH,
    Layout,
)
from carpark_mj.scene import materials
from carpark_mj.scene.mesh import add_mesh, merge
from carpark_mj.scene.parts import yaw_quat


def add_bay_lines(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints both long sides of every bay and its far end."""
    for bay in np.flatnonzero(np.asarray(layout.bay_mask)):
        x, y, yaw = np.asarray(layout.bay_pose[bay], float)
        length, width = np.asarray(layout.bay_size[bay], float)
        cos, sin = math.cos(yaw), math.sin(yaw)
        half = LINE_WIDTH / 2
        lines = {
            "left": (0.0, width / 2, length / 2, half),
            "right": (0.0, -width / 2, length / 2, half),
            "end": (-length / 2 + half, 0.0, half, width / 2),
        }
        for name, (dx, dy, half_x, half_y) in lines.items():
            spec.worldbody.add_geom(
                name=f"bay{bay}/{name}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[x + cos * dx - sin * dy, y + sin * dx + cos * dy, 0.0],
                quat=yaw_quat(yaw),
                size=[half_x, half_y, LINE_HEIGHT],
                rgba=materials.LINE,
                castshadow=False,
                contype=0,
                conaffinity=0,
                group=1,
            )


def add_lane_arrows(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Paints arrows of travel on every one-way lane."""
    rows = np.flatnonzero(np.asarray(layout.lane_mask & layout.lane_one_way))
    if not rows.size:
        return
    half, head = ARROW_LENGTH / 2, ARROW_LENGTH * ARROW_HEAD
    thick = 2 * ARROW_HEIGHT  # half of it under the ground
    shaft = trimesh.creation.box(
        (ARROW_LENGTH - head, ARROW_WIDTH * ARROW_SHAFT, thick)
    )
    shaft.apply_translation((-head / 2, 0.0, 0.0))
    corners = [
        (half, 0.0),
        (half - head, ARROW_WIDTH / 2),
        (half - head, -ARROW_WIDTH / 2),
    ]
    tip = trimesh.convex.convex_hull(
        np.array([(x, y, z) for x, y in corners for z in (-ARROW_HEIGHT, ARROW_HEIGHT)])
    )
    arrow = merge([shaft, tip])
    add_mesh(spec, "arrow", arrow)
    for lane in rows:
        x, y, yaw = np.asarray(layout.lane_pose[lane], float)
        length = float(layout.lane_size[lane, 0])
        count = max(int(length / ARROW_SPACING), 1)
        for k in range(count):
            along = ((k + 0.5) / count - 0.5) * length
            spec.worldbody.add_geom(
                name=f"lane{lane}/arrow{k}",
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname="arrow",
                pos=[x + along * math.cos(yaw), y + along * math.sin(yaw), 0.0],
                quat=yaw_quat(yaw),
                rgba=materials.LINE,
                castshadow=False,
                contype=0,
                conaffinity=0,
                group=1,
            )
