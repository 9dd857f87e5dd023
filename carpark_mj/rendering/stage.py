"""The scene of a lot with its cars put where they are; needs no OpenGL."""

import math

import mujoco
import numpy as np

from carpark_mj.layouts.types import Layout
from carpark_mj.scene import build_scene
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.parameters import VehicleParameters


class Stage:
    """A compiled scene and the poses of everything in it."""

    def __init__(
        self,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
    ) -> None:
        """Compiles the scene.

        Args:
            layout: the lot.
            params: vehicle of all cars.
            num_agents: agents.
            num_parked_cars: parked cars.
        """
        self._params = params
        self._num_agents = num_agents
        self.model = build_scene(layout, params, num_agents, num_parked_cars).compile()
        self.data = mujoco.MjData(self.model)
        self._parked = [
            self.model.joint(f"parked{k}/x").qposadr[0] for k in range(num_parked_cars)
        ]
        self.reset()

    def reset(self) -> None:
        """Turns the wheels back; the next poses are the first."""
        self._spin = np.zeros(self._num_agents)
        self._last = np.full((self._num_agents, 3), np.nan)

    def place(
        self, pose_w: np.ndarray, steering: np.ndarray, parked_pose: np.ndarray
    ) -> None:
        """Puts all cars in their places; wheels roll by the way since the last call.

        Args:
            pose_w: (agents, 3) footprint centres.
            steering: (agents,) bicycle angles [rad].
            parked_pose: (parked cars, 3) footprint centres.
        """
        self._roll(pose_w)
        for k in range(self._num_agents):
            self._place_agent(k, pose_w[k], float(steering[k]))
        for address, pose in zip(self._parked, parked_pose, strict=True):
            self.data.qpos[address : address + 3] = self._rear_axle(pose)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

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
        turn = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
        self.data.joint(f"agent{agent}/root").qpos = [x, y, 0.0, *turn]
        tan = math.tan(steering)
        skew = self._params.track_width / (2 * self._params.wheelbase) * tan
        for name, sign in zip(STEERED, (-1.0, 1.0), strict=True):
            angle = math.atan(tan / (1.0 + sign * self._params.ackermann * skew))
            self.data.joint(f"agent{agent}/steer_{name}").qpos = angle
        for name in WHEELS:
            self.data.joint(f"agent{agent}/spin_{name}").qpos = self._spin[agent]
