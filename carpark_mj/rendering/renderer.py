"""Off-screen pictures of a lot through MuJoCo's own renderer."""

import math
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from carpark_mj.observations.fields import Tracked
from carpark_mj.rendering.gl import why_nothing_is_drawn
from carpark_mj.rendering.recording import tracked_points
from carpark_mj.rendering.stage import Snapshot, Stage
from carpark_mj.scene.camera_flags import LOT_CAMERAS, camera_names, followed_agents
from carpark_mj.scene.looks import agent_colour
from carpark_mj.scene.parts import HULL_GROUP, cabin_geoms

Rgba = tuple[float, float, float, float]

MARKER_HEIGHT = 0.01  # m, height of markers that lie on the asphalt
CIRCLE_SIDES = 40


class Markers:
    """Adds geoms to an `MjvScene` for one frame."""

    def __init__(self, scene: Any) -> None:
        """Draws into `scene`, on top of the model's geoms."""
        self._scene = scene

    def _add(
        self, kind: Any, rgba: Rgba, place: Any, yaw: float = 0.0, size: Any = (0, 0, 0)
    ) -> Any:
        scene, cos, sin = self._scene, math.cos(yaw), math.sin(yaw)
        geom, place = scene.geoms[scene.ngeom], np.array(place, float)
        axes = np.array([cos, -sin, 0, sin, cos, 0, 0, 0, 1])
        mujoco.mjv_initGeom(
            geom, kind, np.array(size, float), place, axes, np.array(rgba)
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
        where, half = [pose[0], pose[1], MARKER_HEIGHT], [*(size / 2 - 0.15), 0.0]
        self._add(mujoco.mjtGeom.mjGEOM_PLANE, rgba, where, pose[2], half)

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
            size = [width / 2, half_side, MARKER_HEIGHT]
            self._add(mujoco.mjtGeom.mjGEOM_BOX, rgba, where, angle, size)


FLASH_COLOURS = {
    "parked": (0.20, 0.85, 0.35),
    "crashed": (0.95, 0.15, 0.15),
    "timed_out": (0.75, 0.75, 0.75),
}


class RenderingError(OSError):
    """OpenGL is not available, or there is no display."""


class _Renderer(mujoco.Renderer):
    """MuJoCo's own, which can go on with another model in the same GL context.

    With a context for every lot a picture takes twice as long, and Mesa 130 MB more.
    Any thread may use it: none keeps the EGL context.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        super().__init__(model, height=height, width=width)
        self._release()

    def render(self, *, out: np.ndarray | None = None) -> np.ndarray:
        try:
            return super().render(out=out)
        finally:
            self._release()

    @staticmethod
    def _release() -> None:
        backend = sys.modules.get("mujoco.egl")  # if that is what MuJoCo draws with
        if backend is not None:
            backend.EGL.eglReleaseThread()

    def load(self, model: mujoco.MjModel) -> None:
        """Uploads meshes and textures of another model in place of the last one's."""
        self._gl_context.make_current()
        self._mjr_context.free()
        scale = mujoco.mjtFontScale.mjFONTSCALE_100
        self._mjr_context = mujoco.MjrContext(model, scale)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._mjr_context)
        self._scene = mujoco.MjvScene(model, self._scene.maxgeom)
        self._model = model
        self._release()


class LotRenderer:
    """Draws instants of driving in one lot, by one camera or two side by side."""

    def __init__(
        self,
        stage: Stage,
        camera: str = "topdown",
        size: tuple[int, int] = (1280, 720),
        tracked: Tracked | None = None,
        rings: Sequence[float] = (),
    ) -> None:
        """Opens a GL context for pictures [pixels] of one of `camera_names`.

        Of the agent that the camera follows, otherwise of all, links to what it tracks
        are drawn, and circles of these diameters [m].
        """
        self._tracked, self._rings = tracked, rings
        self.cameras = camera_names(camera, stage.num_agents)
        self._observers = followed_agents(self.cameras) or range(stage.num_agents)
        self.width, self.height = size[0] // len(self.cameras), size[1]
        self._take(stage)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # GLFW says in several what fails
                self._renderer = _Renderer(self.model, self.width, self.height)
        except Exception as error:  # PyOpenGL and MuJoCo raise many kinds
            raise RenderingError(why_nothing_is_drawn(error)) from None

    def show_lot(self, stage: Stage) -> None:
        """Draws another lot with as many agents from now on; its cars stay."""
        if stage is not self._stage:
            self._take(stage)
            self._renderer.load(self.model)

    def _take(self, stage: Stage) -> None:
        self._stage, self.model, self.data = stage, stage.model, stage.data
        stage.fill_frames(self.width / self.height)
        # The buffer is no larger than a frame: clearing it and smoothing edges take
        # time for every pixel.
        screen = self.model.vis.global_
        screen.offwidth, screen.offheight = self.width, self.height

    def place(self, seen: Snapshot) -> None:
        """Places all cars; wheels roll by the distance since the last call."""
        self._stage.place(seen)

    def draw(self, seen: Snapshot, camera: str) -> np.ndarray:
        """Draws the placed cars, (height, width, 3) uint8, by one of `cameras`."""
        scene = self._update_scene(self._stage.camera(camera))
        # The cameras that show the lot look down on it, so there is no sky to draw.
        scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = camera not in LOT_CAMERAS
        markers = Markers(scene)
        for k in range(self._stage.num_agents):
            rgb = agent_colour(k)[:3]
            goal, here = seen.goal_pose[k], seen.pose_w[k]
            if np.isnan(goal).any():
                continue
            markers.bay(goal, seen.goal_size[k], (*rgb, 0.45))
            if seen.active[k]:
                markers.line(here, goal, (*rgb, 0.9), 0.07, 0.05)
        self._draw_extras(markers, seen)
        for flash in seen.flashes:
            rgba = (*FLASH_COLOURS[flash.outcome], 1.0 - 0.8 * flash.age)
            radius = self._stage.params.length * (0.6 + 0.5 * flash.age)
            markers.circle(flash.pose_w, radius, rgba, 0.35)
        return self._renderer.render()

    def _update_scene(self, camera: str) -> Any:
        """The scene as a camera sees it; a driver not the own car's roof and glass."""
        hidden = np.zeros(0, int)
        if camera.endswith("/driver"):
            car = self.model.cam_bodyid[self.model.camera(camera).id]
            hidden = cabin_geoms(self.model, car)
        groups = self.model.geom_group[hidden]
        self.model.geom_group[hidden] = HULL_GROUP
        self._renderer.update_scene(self.data, camera=camera)
        self.model.geom_group[hidden] = groups
        return self._renderer.scene

    def _draw_extras(self, markers: Markers, seen: Snapshot) -> None:
        """Rings and links of the observers."""
        for agent in self._observers:
            rgba = (*agent_colour(agent)[:3], 0.5)
            for diameter in self._rings:
                markers.circle(seen.pose_w[agent], diameter / 2, rgba, 0.05)
        tracked = self._tracked
        for agent, point in tracked_points(seen, tracked) if tracked else ():
            if agent in self._observers:
                rgba = (*agent_colour(agent)[:3], 0.6)
                markers.line(seen.pose_w[agent], point, rgba, 0.025, 0.04)

    def project(self, point: np.ndarray, camera: str) -> tuple[float, float] | None:
        """Pixel (x, y) of a world point (3,) seen by a camera; None behind it."""
        index = self.model.camera(self._stage.camera(camera)).id
        axes = self.data.cam_xmat[index].reshape(3, 3)
        x, y, z = axes.T @ (point - self.data.cam_xpos[index])
        if z > -0.1:
            return None
        focal = self.height / 2 / math.tan(math.radians(self.model.cam_fovy[index]) / 2)
        return self.width / 2 - focal * x / z, self.height / 2 + focal * y / z

    def close(self) -> None:
        """Frees the GL context."""
        self._renderer.close()
