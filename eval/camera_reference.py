"""MuJoCo's images of a state, resampled at the rays of any camera.

Six pinhole images make a cube about the camera. On a plane the inverse of the depth
is linear across a picture, so it is interpolated between the four pixels about a ray
exactly if all four show one object; otherwise the ray is on an edge.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from carpark_mj import ParkingEnv
from carpark_mj.cameras.rig import BODY, CABIN, Rig, Seen
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.layouts.types import GROUND_CLEARANCE, Layout
from carpark_mj.rendering.recording import snapshot_of
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene.parts import GROUND, HULL_GROUP, car_prefix
from carpark_mj.types import NO_BAY, State
from carpark_mj.vehicle.parameters import VehicleParameters

BLOCK_GROUP = 4  # of cars as blocks
LOOK_GROUP = 2  # of cars as meshes
PIXELS = 512  # of a side of a face
_SPAN = 1.02  # half a face over its distance: neighbours of every ray are on it
_NEAR = 0.004  # m, the nearest that MuJoCo draws
_FACES = np.array(  # axis, left and up of each face
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    ],
    float,
)


class BlockStage(Stage):
    """A lot's scene with the mesh of every car and the blocks that cameras see."""

    def build(self) -> mujoco.MjSpec:
        """The scene with blocks, and a camera `free`."""
        spec = super().build()
        for agent in range(self.num_agents):
            for kind, params in enumerate(self._kinds):
                prefix = car_prefix(agent, kind)
                _add_blocks(spec.body(f"{prefix}car"), params, prefix)
        for k, params in enumerate(self._parked_cars):
            _add_blocks(spec.body(f"parked{k}"), params, f"parked{k}/")
        for geom in spec.geoms:
            if "/digit" in geom.name:  # cameras do not see the numbers of bays
                geom.group = HULL_GROUP
        spec.worldbody.add_camera(name="free", fovy=2 * math.degrees(math.atan(_SPAN)))
        spec.visual.quality.offsamples = 0
        spec.visual.global_.offwidth = spec.visual.global_.offheight = PIXELS
        spec.visual.map.znear = _NEAR / spec.stat.extent
        spec.visual.map.zfar = 5000.0 / spec.stat.extent
        return spec


def _add_blocks(body: Any, params: VehicleParameters, prefix: str) -> None:
    for name, block in (("body", BODY), ("cabin", CABIN)):
        rear, front, wide, low, high = block
        bottom, top = max(low * params.height, GROUND_CLEARANCE), high * params.height
        half = params.length / 2
        ahead = params.centre_offset + half * (rear + front) / 2
        body.add_geom(
            name=f"{prefix}block/{name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[ahead, 0.0, (bottom + top) / 2],
            size=np.array([half * (front - rear), wide * params.width, top - bottom])
            / 2,
            group=BLOCK_GROUP,
            **dict.fromkeys(("contype", "conaffinity", "mass"), 0),
        )


class Reference(NamedTuple):
    """MuJoCo's image along rays (...): depths [m], inf in the sky, and `Seen`.

    On an edge (bool) objects meet, and the depth belongs to none.
    """

    depth: np.ndarray
    seen: np.ndarray
    on_edge: np.ndarray


class Renderer:
    """Draws the states of one lot after another."""

    def __init__(self, env: ParkingEnv, state: State, meshes: bool = False) -> None:
        """Compiles the scene of a lot; `meshes` draws cars as meshes, not as blocks."""
        self._layout = jax.tree.map(np.asarray, state.layout)
        self._state = state
        self._stage = BlockStage.of(env, state)
        self._stage.place(snapshot_of(state))
        self._heights = [
            env.fleet.agents[0 if state.kind is None else int(state.kind[k])].height
            for k in range(env.config.num_agents)
        ]
        self._renderer = mujoco.Renderer(self._stage.model, PIXELS, PIXELS)
        self._options = mujoco.MjvOption()
        shown = (0, 1, LOOK_GROUP if meshes else BLOCK_GROUP)
        self._options.geomgroup[:] = [k in shown for k in range(6)]
        self._kinds, self._owner = _read_geoms(self._stage.model, state)

    def close(self) -> None:
        """Frees the GL context."""
        self._renderer.close()

    def show(self, rig: Rig, agent: int) -> Reference:
        """Pictures (cameras, height, width) of an agent's cameras."""
        x, y, yaw = np.asarray(self._state.motion.pose_w[agent], float)
        length, width = np.asarray(self._state.motion.size[agent], float)
        scale = np.array([length / 2, width / 2, self._heights[agent]])
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        shots = []
        for camera, rays in zip(rig.cameras, rig.directions, strict=True):
            eye = turn @ (np.array(camera.position) * scale) + [x, y, 0.0]
            shots.append(self._shoot(eye, rays @ turn.T, agent))
        return Reference(*(np.stack(part) for part in zip(*shots, strict=True)))

    def _shoot(self, eye: np.ndarray, rays: np.ndarray, agent: int) -> tuple[Any, ...]:
        """Depth, what is seen and edges along rays (..., 3) of the world."""
        depth = np.full(rays.shape[:-1], np.inf)
        geom = np.full(rays.shape[:-1], -1)
        edge = np.zeros(rays.shape[:-1], bool)
        along = rays @ _FACES[:, 0].T
        facing = np.argmax(along, axis=-1)
        for face, axes in enumerate(_FACES):
            here = facing == face
            if here.any():
                inverse, ids = self._face(eye, axes)
                mine = rays[here] @ axes.T
                near, geom[here], edge[here] = _sample(
                    inverse, ids, mine[:, 1:] / mine[:, :1]
                )
                with np.errstate(divide="ignore"):
                    depth[here] = 1.0 / (near * mine[:, 0])
        depth = np.where(geom < 0, np.inf, depth)
        seen = np.where(geom < 0, Seen.SKY, self._kinds[geom])
        seen[(geom >= 0) & (self._owner[geom] == agent)] = Seen.OWN_CAR
        # Bays are areas of the ground.
        on = geom == self._stage.model.geom(GROUND).id
        points = eye[:2] + rays[on][:, :2] * (-eye[2] / rays[on][:, 2:])
        seen[on] = _on_ground(self._layout, int(self._state.goal[agent]), points)
        return depth, seen, edge

    def _face(self, eye: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inverse depths [1/m] and geoms (rows, columns) of one face."""
        model, data = self._stage.model, self._stage.data
        camera = model.camera("free").id
        axis, left, up = axes
        data.cam_xpos[camera] = eye
        data.cam_xmat[camera] = np.stack([-left, up, -axis], axis=1).ravel()
        self._renderer.update_scene(data, camera="free", scene_option=self._options)
        self._renderer.enable_depth_rendering()
        inverse = 1.0 / self._renderer.render().astype(float)
        self._renderer.disable_depth_rendering()
        self._renderer.enable_segmentation_rendering()
        ids = self._renderer.render()[..., 0]
        self._renderer.disable_segmentation_rendering()
        return inverse, ids


def _sample(
    inverse: np.ndarray, ids: np.ndarray, slopes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse depths, geoms and edges at slopes (n, 2) to the left and up."""
    column = (1.0 - slopes[:, 0] / _SPAN) * PIXELS / 2 - 0.5
    row = (1.0 - slopes[:, 1] / _SPAN) * PIXELS / 2 - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    x, y = column - left, row - top
    corners = [(top + i, left + j) for i in (0, 1) for j in (0, 1)]
    shares = [(1 - y) * (1 - x), (1 - y) * x, y * (1 - x), y * x]
    near = sum(share * inverse[at] for share, at in zip(shares, corners, strict=True))
    around = np.stack([ids[at] for at in corners])
    nearest = ids[np.rint(row).astype(int), np.rint(column).astype(int)]
    return np.asarray(near), nearest, (around != nearest).any(axis=0)


def _read_geoms(model: mujoco.MjModel, state: State) -> tuple[np.ndarray, np.ndarray]:
    """`Seen` (geoms,) by the names of MuJoCo's geoms and bodies, and whose cars.

    Shows only the named geoms of movers, which are those of collisions.

    Returns:
        What each geom is, and the agent whose car it is of, -1 = none.
    """
    movers = [group.kind for group in state.movers.groups for _ in range(group.count)]
    kinds, owners = np.full(model.ngeom, int(Seen.FLOOR)), np.full(model.ngeom, -1)
    for k in range(model.ngeom):
        name, body = model.geom(k).name, model.geom_bodyid[k]
        root = model.body(model.body_rootid[body]).name.partition("/")[0]
        if model.body(body).name.startswith("mover"):
            model.geom_group[k] = 0 if name else HULL_GROUP
        if root.startswith(("agent", "parked")):
            kinds[k] = Seen.CAR
            if root.startswith("agent"):
                owners[k] = int(root.removeprefix("agent"))
        elif root.startswith("mover"):
            person = movers[int(root.removeprefix("mover"))] == ObstacleKind.PERSON
            kinds[k] = Seen.PERSON if person else Seen.CAR
        elif name.startswith(("wall", "disc")):
            kinds[k] = Seen.WALL
        elif name.startswith(("bay", "lane")):
            kinds[k] = Seen.LINE
        elif not name:  # the visible box of a low wall
            kinds[k] = Seen.KERB
    return kinds, owners


def _on_ground(layout: Layout, goal: int, points: np.ndarray) -> np.ndarray:
    """Floor, bay or own bay at points (n, 2) of the ground."""
    seen = np.full(len(points), int(Seen.FLOOR))
    for bay in np.flatnonzero(layout.bay_mask):
        x, y, yaw = np.asarray(layout.bay_pose[bay], float)
        offset = points - [x, y]
        cos, sin = math.cos(yaw), math.sin(yaw)
        local = np.abs(offset @ np.array([[cos, -sin], [sin, cos]]))
        inside = (local <= np.asarray(layout.bay_size[bay], float) / 2).all(axis=1)
        kind = Seen.OWN_BAY if goal != NO_BAY and bay == goal else Seen.BAY
        seen[inside & (seen != Seen.OWN_BAY)] = kind
    return seen
