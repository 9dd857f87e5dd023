"""Off-screen pictures of a lot through MuJoCo's own renderer."""

import math
import os
from typing import Any

import mujoco
import numpy as np

from carpark_mj.layouts.types import Layout
from carpark_mj.rendering.gl import MISSING_GL
from carpark_mj.scene import build_scene
from carpark_mj.scene.materials import agent_colour
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.parameters import VehicleParameters

GOAL_HEIGHT = 0.01  # m, goal markers lie on the asphalt


class RenderingError(Exception):
    """No picture can be made on this machine, or none of what was asked for."""


def _mujoco_renderer(model: mujoco.MjModel, width: int, height: int) -> Any:
    try:
        return mujoco.Renderer(model, height=height, width=width)
    except Exception as error:  # PyOpenGL and MuJoCo raise many kinds
        backend = os.environ.get("MUJOCO_GL", "unset")
        raise RenderingError(
            f"{MISSING_GL}. MUJOCO_GL is {backend}; the error was: {error}"
        ) from None


class LotRenderer:
    """Draws poses of agents and parked cars in the scene of one lot."""

    def __init__(
        self,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
        camera: str = "topdown",
        size: tuple[int, int] = (1280, 720),
    ) -> None:
        """Compiles the scene and opens a GL context.

        Args:
            layout: the lot.
            params: vehicle of all cars.
            num_agents: agents.
            num_parked_cars: parked cars.
            camera: `topdown`, `overview` or `chase:K` behind agent K.
            size: width and height of a frame [pixels].

        Raises:
            RenderingError: no GL, or no such camera.
        """
        self._params = params
        self._num_agents = num_agents
        self._bay_pose = np.asarray(layout.bay_pose, float)
        self._bay_size = np.asarray(layout.bay_size, float)
        self.camera = camera_name(camera, num_agents)
        self.width, self.height = size
        self.model = build_scene(layout, params, num_agents, num_parked_cars).compile()
        self.data = mujoco.MjData(self.model)
        self._renderer = _mujoco_renderer(self.model, *size)
        self._parked = [
            self.model.joint(f"parked{k}/x").qposadr[0] for k in range(num_parked_cars)
        ]
        self._spin = np.zeros(num_agents)
        self._last = np.full((num_agents, 3), np.nan)

    def render(
        self,
        pose_w: np.ndarray,
        steering: np.ndarray,
        goal: np.ndarray,
        parked_pose: np.ndarray,
    ) -> np.ndarray:
        """Draws one frame.

        Args:
            pose_w: (agents, 3) footprint centres.
            steering: (agents,) bicycle angles [rad].
            goal: (agents,) bay indices.
            parked_pose: (parked cars, 3) footprint centres.

        Returns:
            (height, width, 3) uint8.
        """
        self._roll(pose_w)
        for k in range(self._num_agents):
            self._place_agent(k, pose_w[k], float(steering[k]))
        for address, pose in zip(self._parked, parked_pose, strict=True):
            self.data.qpos[address : address + 3] = self._rear_axle(pose)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self._renderer.update_scene(self.data, camera=self.camera)
        for k in range(self._num_agents):
            self._mark_goal(k, self._bay_pose[goal[k]], self._bay_size[goal[k]])
            self._mark_way(k, pose_w[k], self._bay_pose[goal[k]])
        return self._renderer.render()

    def project(self, point: np.ndarray) -> tuple[float, float] | None:
        """Pixel (x, y) of a world point (3,) in the last frame; None behind it."""
        camera = self.model.camera(self.camera).id
        axes = self.data.cam_xmat[camera].reshape(3, 3)
        x, y, z = axes.T @ (point - self.data.cam_xpos[camera])
        if z > -0.1:
            return None
        focal = (
            self.height / 2 / math.tan(math.radians(self.model.cam_fovy[camera]) / 2)
        )
        return self.width / 2 - focal * x / z, self.height / 2 + focal * y / z

    def close(self) -> None:
        """Frees the GL context."""
        self._renderer.close()

    def _rear_axle(self, centre: np.ndarray) -> tuple[float, float, float]:
        x, y, yaw = centre
        offset = self._params.centre_offset
        return x - offset * math.cos(yaw), y - offset * math.sin(yaw), yaw

    def _roll(self, pose_w: np.ndarray) -> None:
        """Turns the wheels by the way driven since the last frame."""
        delta = pose_w - self._last
        ahead = np.cos(pose_w[:, 2]) * delta[:, 0] + np.sin(pose_w[:, 2]) * delta[:, 1]
        jumped = np.abs(ahead) > 1.0  # a respawn, or the first frame
        ahead = np.where(np.isnan(ahead) | jumped, 0.0, ahead)
        self._spin += ahead / self._params.wheel_radius
        self._last = np.array(pose_w, float)

    def _place_agent(self, agent: int, centre: np.ndarray, steering: float) -> None:
        x, y, yaw = self._rear_axle(centre)
        root = self.data.joint(f"agent{agent}/root")
        root.qpos = [x, y, 0.0, *_yaw_quat(yaw)]
        tan = math.tan(steering)
        skew = self._params.track_width / (2 * self._params.wheelbase) * tan
        for name, sign in zip(STEERED, (-1.0, 1.0), strict=True):
            angle = math.atan(tan / (1.0 + sign * self._params.ackermann * skew))
            self.data.joint(f"agent{agent}/steer_{name}").qpos = angle
        for name in WHEELS:
            self.data.joint(f"agent{agent}/spin_{name}").qpos = self._spin[agent]

    def _add_geom(self, kind: Any, rgba: tuple[float, ...]) -> Any:
        scene = self._renderer.scene
        if scene.ngeom >= scene.maxgeom:
            raise RenderingError("the scene holds too many geoms to add markers")
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), np.array(rgba)
        )
        scene.ngeom += 1
        return geom

    def _mark_goal(self, agent: int, pose: np.ndarray, size: np.ndarray) -> None:
        """Fills the goal bay with the agent's colour."""
        rgba = (*agent_colour(agent)[:3], 0.45)
        geom = self._add_geom(mujoco.mjtGeom.mjGEOM_BOX, rgba)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        geom.pos[:] = [pose[0], pose[1], GOAL_HEIGHT]
        geom.mat[:] = [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
        geom.size[:] = [size[0] / 2 - 0.15, size[1] / 2 - 0.15, GOAL_HEIGHT / 2]

    def _mark_way(self, agent: int, pose: np.ndarray, goal: np.ndarray) -> None:
        """A thin line from the car to its goal."""
        rgba = (*agent_colour(agent)[:3], 0.9)
        geom = self._add_geom(mujoco.mjtGeom.mjGEOM_CAPSULE, rgba)
        mujoco.mjv_connector(
            geom,
            mujoco.mjtGeom.mjGEOM_CAPSULE,
            0.05,
            np.array([pose[0], pose[1], 0.05]),
            np.array([goal[0], goal[1], 0.05]),
        )


def _yaw_quat(yaw: float) -> list[float]:
    return [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]


def camera_name(camera: str, num_agents: int) -> str:
    """The camera's name in the scene.

    Raises:
        RenderingError: no such camera; the message lists them.
    """
    if camera in ("topdown", "overview"):
        return camera
    kind, _, agent = camera.partition(":")
    if kind == "chase" and agent.isdecimal() and int(agent) < num_agents:
        return f"agent{int(agent)}/chase"
    raise RenderingError(
        f"no camera {camera!r}; choose topdown, overview or chase:K with K from 0 to "
        f"{num_agents - 1}"
    )
