"""The junction as a plan and as a MuJoCo scene.

As a `Layout` it goes wherever a lot goes: into the renderer
(`carpark_papers.cederle.video`), and into drivable scenes for any viewer.
"""

import mujoco
import numpy as np

from carpark_mj.layouts.build import assemble, lanes, walls
from carpark_mj.layouts.types import LINE_HEIGHT, Layout, WallKind
from carpark_mj.scene import looks
from carpark_mj.scene.build import drivable_scene
from carpark_mj.vehicle import VehicleParameters
from carpark_papers.cederle.junction.roads import (
    CORNER,
    CORNER_CENTRES,
    EAST,
    HALF_ROAD,
    LANE_WIDTH,
    LANES,
    MARKINGS,
    MOUTH,
    SOUTH,
    WEST,
)

KERB_WIDTH, KERB_HEIGHT = 0.15, 0.14  # m
HALF = 40.0  # m, half width of the ground, which holds all arms
_EDGE = HALF + 1.0  # m, where the grass around a lot begins


def plan() -> Layout:
    """The roads as a layout: walls are kerbs and grass; it has lanes and no bays."""
    out = HALF_ROAD + KERB_WIDTH
    grass = [(WEST, EAST, out, _EDGE)]
    kerbs = [(WEST, EAST, HALF_ROAD, out)]
    for side in (-1, 1):
        end = WEST if side < 0 else EAST
        grass += [
            (side * MOUTH, end, -_EDGE, -out),
            (side * out, side * MOUTH, -_EDGE, -MOUTH),
            (end, side * _EDGE, -_EDGE, _EDGE),  # beyond the end of the arm
        ]
        kerbs += [
            (side * MOUTH, end, -out, -HALF_ROAD),
            (side * HALF_ROAD, side * out, SOUTH, -MOUTH),
        ]
    grass.append((-out, out, -_EDGE, SOUTH))
    rows: list[np.ndarray] = []
    for start, end in LANES.values():
        way = np.subtract(end, start)
        yaw = np.arctan2(way[1], way[0])
        rows.append(np.array([*np.add(start, end) / 2, yaw, np.hypot(*way)]))
    lane = np.array(rows)
    size = np.stack([lane[:, 3], np.full(len(lane), LANE_WIDTH)], axis=1)
    return assemble(
        (HALF, HALF),
        walls(*_boxes(grass), WallKind.ISLAND),
        walls(*_boxes(kerbs), WallKind.KERB),
        lanes(lane[:, :3], size),
    )


def add_paint(spec: mujoco.MjSpec) -> None:
    """Adds paint beyond a layout: lines between directions, and rounded corners."""
    still = {"contype": 0, "conaffinity": 0, "group": 1, "castshadow": False}
    for k, ((x, y), (length, width)) in enumerate(MARKINGS):
        spec.worldbody.add_geom(
            name=f"line{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, 0.0],
            size=[length / 2, width / 2, LINE_HEIGHT],
            rgba=looks.LINE,
            **still,
        )
    for k, (x, y) in enumerate(CORNER_CENTRES):
        inner = (CORNER - KERB_WIDTH, KERB_HEIGHT + 0.001, looks.GREEN)
        for name, (radius, height, colour) in (
            ("kerb", (CORNER, KERB_HEIGHT - 0.001, looks.KERB)),
            ("grass", inner),
        ):
            spec.worldbody.add_geom(
                name=f"corner{k}/{name}",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=[x, y, height / 2],
                size=[radius, height / 2, 0.0],
                rgba=colour,
                **still,
            )


def drivable_junction(params: VehicleParameters, pose_w: np.ndarray) -> mujoco.MjSpec:
    """A self-contained scene on contact wheels, cars at poses (cars, 3) and at rest."""
    spec = drivable_scene(plan(), params, pose_w, np.zeros((0, 3)))
    spec.modelname = "junction"
    add_paint(spec)
    return spec


def _boxes(
    sides: list[tuple[float, float, float, float]],
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 3) and sizes (n, 2) of boxes between two x and two y, in any order."""
    x0, x1, y0, y1 = np.array(sides).T
    pose = np.stack([(x0 + x1) / 2, (y0 + y1) / 2, np.zeros_like(x0)], axis=1)
    return pose, np.stack([np.abs(x1 - x0), np.abs(y1 - y0)], axis=1)
