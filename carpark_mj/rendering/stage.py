"""Instants in a lot, and its scene with all in their places; it needs no OpenGL."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import mujoco
import numpy as np

from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.scene.build import build_scene
from carpark_mj.scene.camera_flags import LOT_CAMERAS
from carpark_mj.scene.cameras import frame_lot
from carpark_mj.scene.movers import Walkers
from carpark_mj.scene.parts import HIDDEN, car_prefix, rear_axle, yaw_quat
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.parameters import VehicleParameters


@dataclasses.dataclass(frozen=True)
class Flash:
    """An episode that has just ended."""

    pose_w: np.ndarray  # (3,) where the car was
    agent: int  # whose it was
    outcome: str  # one of `OUTCOMES`
    age: float  # 0 when it ended, 1 when the flash is over


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """One instant."""

    pose_w: np.ndarray  # (agents, 3) footprint centres
    steering: np.ndarray  # (agents,) bicycle angles [rad]
    goal_pose: np.ndarray  # (agents, 3) goal bays; NaN for agents that explore
    goal_size: np.ndarray  # (agents, 2) of goal bays [m]; NaN likewise
    parked_pose: np.ndarray  # (parked cars, 3) footprint centres
    active: np.ndarray  # (agents,) bool, the agent's episode is running
    seconds: float = 0.0  # since the start
    # a word or two per agent: what it does, or how its episode ended
    state: tuple[str, ...] = ()
    # numbers to show by name: episodes ended so far, by outcome
    tally: Mapping[str, float] = dataclasses.field(default_factory=dict)
    flashes: tuple[Flash, ...] = ()  # episodes that ended a moment ago
    # (agents,) which of the fleet's kinds of cars they drive; None if it has one
    kind: np.ndarray | None = None
    # (agents, slots, 2) centres of tracked bays, NaN in empty slots; None while
    # goals are fixed
    tracked_bay_xy: np.ndarray | None = None
    movers: tuple[Group, ...] = ()  # obstacles that move by themselves


class Stage:
    """A compiled scene, `model` and `data`, and the poses of everything in it."""

    def __init__(
        self,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
        agent_kinds: Sequence[VehicleParameters] = (),
        parked_cars: Sequence[VehicleParameters] = (),
        movers: Sequence[Group] = (),
    ) -> None:
        """Compiles the scene.

        All cars are vehicles of `params`, unless `agent_kinds` are those that agents
        may drive, and `parked_cars` those of the parked cars, one each. Movers may be
        anywhere, but have their final sizes.
        """
        self.layout, self.params, self.num_agents = layout, params, num_agents
        self._kinds = tuple(agent_kinds) or (params,)
        self._kind = np.zeros(num_agents, int)
        self._parked_cars = tuple(parked_cars) or (params,) * num_parked_cars
        self._movers = tuple(movers)
        self.model = self.build().compile()
        self.data = mujoco.MjData(self.model)
        self._parked = [
            self.model.joint(f"parked{k}/x").qposadr[0] for k in range(num_parked_cars)
        ]
        self.reset()

    @classmethod
    def of(cls, env: Any, state: Any, num_agents: int | None = None) -> Self:
        """The scene of a lot of a `ParkingEnv`, for all of its agents by default."""
        return cls(
            state.layout,
            env.vehicle,
            env.num_agents if num_agents is None else num_agents,
            env.config.num_parked_cars,
            env.fleet.agents,
            env.fleet.parked_vehicles(state.parked_cars),
            state.movers.groups,
        )

    def build(self) -> mujoco.MjSpec:
        """The scene to compile."""
        return build_scene(
            self.layout,
            self.params,
            self.num_agents,
            self._parked_cars,
            agent_kinds=self._kinds,
            movers=self._movers,
        )

    def reset(self) -> None:
        """Turns the wheels back; the next poses are the first."""
        num_agents = self._kind.shape[0]
        self._walkers = Walkers()
        self._spin = np.zeros(num_agents)
        self._last = np.full((num_agents, 3), np.nan)

    def place(self, seen: Snapshot) -> None:
        """Places all cars and movers; wheels roll by the distance since the last."""
        if seen.kind is not None:
            self._kind = np.asarray(seen.kind)
        self._roll(seen.pose_w)
        for agent, shown in enumerate(self._kind):
            for each in range(len(self._kinds)):
                root = self.data.joint(f"{car_prefix(agent, each)}root")
                root.qpos = [0.0, 0.0, HIDDEN, 1.0, 0.0, 0.0, 0.0]
            steering = float(seen.steering[agent])
            self._place_agent(agent, int(shown), seen.pose_w[agent], steering)
        for address, pose, params in zip(
            self._parked, seen.parked_pose, self._parked_cars, strict=True
        ):
            self.data.qpos[address : address + 3] = rear_axle(params, pose)
        for name, (pos, quat) in self._walkers.places(seen.movers).items():
            mocap = self.model.body(name).mocapid[0]
            self.data.mocap_pos[mocap], self.data.mocap_quat[mocap] = pos, quat
        self._update()

    def fill_frames(self, aspect: float) -> None:
        """Moves `LOT_CAMERAS` so that the lot fills frames of an aspect ratio."""
        for name in LOT_CAMERAS:
            eye, quat = frame_lot(name, np.asarray(self.layout.extent), aspect)
            camera = self.model.camera(name)
            camera.pos, camera.quat = eye, quat
        self._update()

    def camera(self, name: str) -> str:
        """The camera `agentK/...` of the car that the agent drives; others as named."""
        owner, slash, rest = name.partition("/")
        if not slash:
            return name
        agent = int(owner.removeprefix("agent"))
        return f"{car_prefix(agent, int(self._kind[agent]))}{rest}"

    def _update(self) -> None:
        """Bodies, cameras and lights in the world, after a change of any."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def _roll(self, pose_w: np.ndarray) -> None:
        """Turns the wheels by the distance driven since the last frame."""
        delta = pose_w - self._last
        ahead = np.cos(pose_w[:, 2]) * delta[:, 0] + np.sin(pose_w[:, 2]) * delta[:, 1]
        jumped = np.abs(ahead) > 1.0  # a respawn, or the first frame
        ahead = np.where(np.isnan(ahead) | jumped, 0.0, ahead)
        self._spin += ahead / [self._kinds[kind].wheel_radius for kind in self._kind]
        self._last = np.array(pose_w, float)

    def _place_agent(
        self, agent: int, kind: int, centre: np.ndarray, steering: float
    ) -> None:
        params, prefix = self._kinds[kind], car_prefix(agent, kind)
        x, y, yaw = rear_axle(params, centre)
        self.data.joint(f"{prefix}root").qpos = [x, y, 0.0, *yaw_quat(yaw)]
        tan = math.tan(steering)
        skew = params.track_width / (2 * params.wheelbase) * tan
        for name, sign in zip(STEERED, (-1.0, 1.0), strict=True):
            angle = math.atan(tan / (1.0 + sign * params.ackermann * skew))
            self.data.joint(f"{prefix}steer_{name}").qpos = angle
        for name in WHEELS:
            self.data.joint(f"{prefix}spin_{name}").qpos = self._spin[agent]
