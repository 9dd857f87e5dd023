"""Markers drawn into the scene: goals, paths, links, circles."""

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

Rgba = tuple[float, float, float, float]

GROUND = 0.01  # m, height of markers that lie on the asphalt
CIRCLE_SIDES = 40


class Markers:
    """Adds geoms to an `MjvScene` for one frame."""

    def __init__(self, scene: Any) -> None:
        """Draws into `scene`, on top of the model's geoms."""
        self._scene = scene

    def _add(self, kind: Any, rgba: Rgba, position: Sequence[float]) -> Any:
        scene = self._scene
        if scene.ngeom >= scene.maxgeom:
            raise RuntimeError(f"the scene is full: {scene.maxgeom} geoms")
        geom = scene.geoms[scene.ngeom]
        place = np.array(position, float)
        mujoco.mjv_initGeom(
            geom, kind, np.zeros(3), place, np.eye(3).ravel(), np.array(rgba)
        )
        # What MuJoCo leaves uninitialised; see-through geoms are drawn by distance.
        geom.objtype, geom.objid = mujoco.mjtObj.mjOBJ_UNKNOWN, -1
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        geom.segid = scene.ngeom
        geom.camdist = np.linalg.norm(place - scene.camera[0].pos)
        geom.castshadow = 0
        scene.ngeom += 1
        return geom

    def bay(self, pose: np.ndarray, size: np.ndarray, rgba: Rgba) -> None:
        """Fills a bay of pose (3,) and size (2,)."""
        where = [pose[0], pose[1], GROUND]
        geom = self._add(mujoco.mjtGeom.mjGEOM_PLANE, rgba, where)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        geom.mat[:] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
        geom.size[:] = [size[0] / 2 - 0.15, size[1] / 2 - 0.15, 0.0]

    def line(
        self, start: np.ndarray, end: np.ndarray, rgba: Rgba, radius: float, z: float
    ) -> None:
        """A line between two points (2,) at height `z`."""
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        ends = [np.array([p[0], p[1], z], float) for p in (start, end)]
        geom = self._add(kind, rgba, np.mean(ends, axis=0))
        mujoco.mjv_connector(geom, kind, radius, *ends)

    def circle(
        self, centre: np.ndarray, radius: float, rgba: Rgba, width: float
    ) -> None:
        """A circle about a point (2,) on the ground, of flat sides that meet."""
        half_side = (radius + width / 2) * math.tan(math.pi / CIRCLE_SIDES)
        for angle in np.linspace(0.0, 2 * math.pi, CIRCLE_SIDES, endpoint=False):
            cos, sin = math.cos(angle), math.sin(angle)
            where = [centre[0] + radius * cos, centre[1] + radius * sin, 0.03]
            geom = self._add(mujoco.mjtGeom.mjGEOM_BOX, rgba, where)
            geom.mat[:] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
            geom.size[:] = [width / 2, half_side, GROUND]
