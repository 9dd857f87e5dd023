"""Compares the pixels of cameras with MuJoCo's rays, in every family of layouts.

python eval/cameras.py
python eval/cameras.py --layouts lot angled --lots 4

Casts the rays of all pixels in MuJoCo, at cars as the two blocks that cameras see and
as meshes. Exit code 1: too few pixels agree.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("cameras", "cameras:main")

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.cameras import RIGS, Heights, see
from carpark_mj.cameras.rig import BODY, CABIN, Rig, Seen
from carpark_mj.config import LAYOUTS, GoalConfig, SpawnConfig
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.evaluation.tables import markdown
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.layouts import BayKind, layout_config, make_layout
from carpark_mj.layouts.types import GROUND_CLEARANCE, Layout
from carpark_mj.rendering.recording import snapshot_of
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene.parts import GROUND, HULL_GROUP, car_prefix
from carpark_mj.types import NO_BAY, State
from carpark_mj.vehicle.parameters import VehicleParameters
from shell import command

BLOCK_GROUP = 4  # of cars as blocks
LOOK_GROUP = 2  # of cars as meshes
_STEP = 1e-6  # m, behind a face that is seen from its back


class BlockStage(Stage):
    """A lot's scene with the mesh of every car and the blocks that cameras see."""

    def build(self) -> mujoco.MjSpec:
        """The scene with blocks."""
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
        return spec


def _add_blocks(body: Any, params: VehicleParameters, prefix: str) -> None:
    for name, block in (("body", BODY), ("cabin", CABIN)):
        rear, front, wide, low, high = block
        bottom, top = max(low * params.height, GROUND_CLEARANCE), high * params.height
        half = params.length / 2
        ahead = params.centre_offset + half * (rear + front) / 2
        # A gap between the blocks: a ray leaves one before it meets the other.
        size = half * (front - rear), wide * params.width, top - bottom - 10 * _STEP
        body.add_geom(
            name=f"{prefix}block/{name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[ahead, 0.0, (bottom + top) / 2],
            size=np.array(size) / 2,
            group=BLOCK_GROUP,
            **dict.fromkeys(("contype", "conaffinity", "mass"), 0),
        )


class Reference:
    """A state of a lot in MuJoCo."""

    def __init__(self, env: ParkingEnv, state: State) -> None:
        """Compiles the scene of the lot."""
        self._layout = jax.tree.map(np.asarray, state.layout)
        self._state = state
        stage = BlockStage.of(env, state)
        stage.place(snapshot_of(state))
        self._model, self._data = stage.model, stage.data
        self._heights = [
            env.fleet.agents[0 if state.kind is None else int(state.kind[k])].height
            for k in range(env.config.num_agents)
        ]
        self._kinds, self._owner = _read_geoms(self._model, state)

    def look(
        self, rig: Rig, agent: int, meshes: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depths [m], inf in the sky, and `Seen` of an agent's cameras.

        Cars are meshes or the blocks that cameras see. Both are (cameras, height,
        width).
        """
        x, y, yaw = np.asarray(self._state.motion.pose_w[agent], float)
        length, width = np.asarray(self._state.motion.size[agent], float)
        scale = np.array([length / 2, width / 2, self._heights[agent]])
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        shown = (0, 1, LOOK_GROUP if meshes else BLOCK_GROUP)
        groups = np.array([k in shown for k in range(6)], np.uint8)
        depths, kinds = [], []
        for camera, rays in zip(rig.cameras, rig.directions, strict=True):
            eye = turn @ (np.array(camera.position) * scale) + [x, y, 0.0]
            rays = rays.reshape(-1, 3) @ turn.T
            depth, geom = self._cast(eye, rays, groups)
            seen = np.where(self._owner[geom] == agent, Seen.OWN_CAR, self._kinds[geom])
            seen[geom < 0] = Seen.SKY
            # Bays are areas of the ground.
            on = geom == self._model.geom(GROUND).id
            points = (eye + depth[on, None] * rays[on])[:, :2]
            seen[on] = _on_ground(self._layout, int(self._state.goal[agent]), points)
            depths.append(depth)
            kinds.append(seen)
        shape = len(rig.cameras), rig.height, rig.width
        return np.reshape(depths, shape), np.reshape(kinds, shape)

    def _cast(
        self, eye: np.ndarray, rays: np.ndarray, groups: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depths and geoms (-1: none) that rays (n, 3) meet first from outside."""
        depth, geom = np.zeros(len(rays)), np.zeros(len(rays), np.int32)
        normal, scene = np.empty(3), (self._model, self._data)
        for k, ray in enumerate(rays):
            normal[:] = ray
            while geom[k] >= 0 and normal @ ray > 0.0:  # in a cabin: faces' backs
                start, found = eye + depth[k] * ray, (geom[k : k + 1], normal)
                far = mujoco.mj_ray(*scene, start, ray, groups, True, -1, *found)
                depth[k] += far + _STEP
        return np.where(geom < 0, np.inf, depth), geom


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


AT_RANDOM = SpawnConfig(close_ratio=0.0, conflict_ratio=0.0, reverse_ratio=0.0)
AGENTS, PARKED_CARS = 2, 8
MOVERS = "pedestrians:number=3", "cart"


def families() -> list[str]:
    """A layout of every family, and all layouts unlike any other."""
    first: dict[str, str] = {}
    for name in LAYOUTS:
        first.setdefault(LAYOUTS[name].family, name)
    return sorted(first.values())


def environment(layout: str) -> ParkingEnv:
    """An environment with at most as many cars as bays.

    In lots with exits agents drive out and no car is parked.
    """
    lot = layout_config(layout)
    kinds = make_layout(lot, jax.random.key(0)).bay_kind
    exits = bool((kinds == BayKind.EXIT).any())
    agents = min(AGENTS, lot.min_goals)
    config = EnvConfig(
        layout=layout,
        num_agents=agents,
        num_parked_cars=0 if exits else min(PARKED_CARS, lot.min_bays - agents),
        goals=GoalConfig(drive_out=exits),
        spawn=AT_RANDOM if exits else SpawnConfig(),
        movers=MOVERS,
    )
    return ParkingEnv(config)


CLOSE = 0.01  # m, of depths that agree
ENOUGH = 0.998  # share of the pixels


class Agreement(NamedTuple):
    """Number of pixels, and shares of them that agree with MuJoCo's rays."""

    pixels: int
    depth: float
    classes: float
    meshes: float = 0.0  # with the class that rays at meshes find


def compare(env: ParkingEnv, states: Sequence[State], meshes: bool = True) -> Agreement:
    """Compares the images of all agents of some lots."""
    heights, shares, pixels = Heights.of(env.fleet), [], 0
    pictures_of = jax.jit(see, static_argnums=(0, 2))
    for state, rig in itertools.product(states, (RIGS["surround"], RIGS["windscreen"])):
        pictures = jax.device_get(pictures_of(rig, state, heights))
        reference = Reference(env, state)
        for agent in range(env.config.num_agents):
            if state.present is not None and not state.present[agent]:
                continue  # it stands far away
            seen = pictures.seen[agent]
            depth, truth = reference.look(rig, agent)
            off = pictures.depth[agent] - np.minimum(depth, rig.reach)
            found = [np.abs(off) < CLOSE, seen == truth]
            found += [seen == reference.look(rig, agent, True)[1]] * meshes
            shares.append(seen.size * np.mean(found, axis=(1, 2, 3)))
            pixels += seen.size
    return Agreement(pixels, *(np.sum(shares, axis=0) / pixels).tolist())


@dataclasses.dataclass(frozen=True)
class CamerasConfig(CheckedConfig):
    """Settings of `python eval/cameras.py`.

    Attributes:
        layouts: of the lots; by default one of every family.
        lots: of each layout.
    """

    layouts: tuple[str, ...] = ()
    lots: Count = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.layouts:
            layout_config(name)  # raises what is unknown


def run(config: CamerasConfig) -> int:
    """Prints the table; returns 1 where too few pixels agree."""
    rows, missed = [], 0
    for name in config.layouts or families():
        env = environment(name)
        reset = jax.jit(lambda key: env.reset(key)[0])  # noqa: B023
        states = [reset(jax.random.key(seed)) for seed in range(config.lots)]
        found = compare(env, states)
        shares = (f"{share:.2%}" for share in found[1:])
        names = "depth within 1 cm", "classes", "meshes"
        row = {"layout": f"`{name}`", "pixels": f"{found.pixels:,}"}
        rows.append(row | dict(zip(names, shares, strict=True)))
        missed += min(found.depth, found.classes) < ENOUGH
    print(markdown(rows))
    return int(missed > 0)


main = command(CamerasConfig, run, __doc__)
