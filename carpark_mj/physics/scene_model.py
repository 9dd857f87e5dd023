"""The MuJoCo model of a whole scene, stepped on the host for a batch of scenes.

The numpy side of `carpark_mj.physics.scene`: addresses of each car in `qpos`, owners of
geoms, and movers as bodies, whose poses change from substep to substep. MuJoCo takes
them to stand still meanwhile: a contact pushes a car by how deep it is, not by a
mover's velocity. Tyres and drivers are not part of it.
"""

import copy
import dataclasses
import math
import os
import re
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.typing import ArrayLike

from carpark_mj.config import SimConfig
from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind
from carpark_mj.layouts.types import MOVER_HEIGHTS, Layout
from carpark_mj.obstacles import poses_during
from carpark_mj.physics.forces import gravity_vector
from carpark_mj.scene.build import build_scene
from carpark_mj.scene.movers import add_solids
from carpark_mj.scene.parts import HIDDEN
from carpark_mj.vehicle.mjcf import STEERED
from carpark_mj.vehicle.parameters import VehicleParameters

# m; hulls crush that far at 14 m/s. What is deeper inside a car has appeared there.
DEEPEST = 0.3


class Solids(NamedTuple):
    """Movers of a batch of scenes of shape `(...)` in a substep."""

    position: ArrayLike  # (..., n, 3) of their feet [m], far below the ground if absent
    yaw: ArrayLike  # (..., n) [rad]
    size: ArrayLike  # (..., n, 3) `geom_size` of MuJoCo [m]


def absent(count: int) -> Solids:
    """Movers of a scene of which none is there."""
    position = jnp.tile(jnp.array([0.0, 0.0, HIDDEN]), (count, 1))
    return Solids(position, jnp.zeros(count), jnp.ones((count, 3)))


def solids_within(
    before: Sequence[Group],
    after: Sequence[Group],
    left: jax.Array,
    pose_w: jax.Array,
    size: jax.Array,
) -> Solids:
    """Movers when a share `left` () of a control step is left, in the groups' order.

    One that is far inside a car of poses (num_agents, 3) and sizes (num_agents, 2)
    would throw it up: it is left out until the car is elsewhere.
    """
    core = size[:, None] - 2.0 * DEEPEST
    rows = [absent(0)]
    for old, new in zip(before, after, strict=True):
        pose = poses_during(old, new, left[None])[:, 0]
        now = dataclasses.replace(new, pose_w=pose)
        there = ~now.overlap(pose_w[:, None], core).any(axis=0)
        there = there if new.mask is None else there & new.mask
        feet = jnp.pad(pose[:, :2], ((0, 0), (0, 1)))
        feet = jnp.where(there[:, None], feet, absent(new.count).position)
        half = jnp.full((new.count, 1), MOVER_HEIGHTS[type(new)] / 2, feet.dtype)
        if isinstance(new, Boxes):
            yaw, size = pose[:, 2], jnp.concatenate([new.size / 2, half], axis=1)
        else:
            columns = (new.size[:, None], half, jnp.zeros_like(half))
            yaw, size = jnp.zeros(new.count), jnp.concatenate(columns, axis=1)
        rows.append(Solids(feet, yaw, size))
    return Solids(*map(jnp.concatenate, zip(*rows, strict=True)))


CAR_NQ, CAR_NV, CAR_BODIES = 13, 12, 7


class Moving(NamedTuple):
    """Variables that a substep changes, of a batch of scenes of shape `(...)`."""

    qpos: ArrayLike  # (..., num_agents, 13) MuJoCo positions of the agents' cars
    qvel: ArrayLike  # (..., num_agents, 12) MuJoCo velocities
    # (..., num_parked_cars, 3) rear axles' centres: x, y [m], yaw [rad]
    parked_qpos: ArrayLike
    parked_qvel: ArrayLike  # (..., num_parked_cars, 3) their rates


class Masses(NamedTuple):
    """Fields of the model of each agent's car alone, whose first body is the world."""

    body_mass: ArrayLike  # (..., num_agents, 8) [kg]
    body_inertia: ArrayLike  # (..., num_agents, 8, 3) [kg m^2]
    body_ipos: ArrayLike  # (..., num_agents, 8, 3) [m]


class SceneModel:
    """The compiled scene of a lot with brush-tyre cars, hull contacts on."""

    def __init__(
        self,
        sim: SimConfig,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
        movers: Sequence[Group] = (),
    ) -> None:
        """Compiles the model; arguments as in `ScenePhysics`."""
        self._num_agents = num_agents
        self._num_parked_cars = num_parked_cars
        spec = build_scene(layout, params, num_agents, (params,) * num_parked_cars)
        add_solids(spec, movers, [f"agent{k}/hull" for k in range(num_agents)])
        spec.option.timestep = sim.sim_dt
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = gravity_vector(sim)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        # A blown-up car must stay visible as non-finite, not be put back silently.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = spec.compile()
        kinds = np.array([g.kind for g in movers for _ in range(g.count)], int)
        solids = [self.model.geom(f"mover{k}").id for k in range(len(kinds))]
        self._movers = np.array(solids, int)
        self._mocap = self.model.body_mocapid[self.model.geom_bodyid[self._movers]]
        self._kind, self._agent = _classify_geoms(self.model)
        self._kind[self._movers] = kinds
        # Of obstacles, columns of `Motion.touched`.
        self.num_kinds = 1 + max([ObstacleKind.WALL, *kinds])
        self.qpos_address = self._addresses("jnt_qposadr", CAR_NQ)
        self.qvel_address = self._addresses("jnt_dofadr", CAR_NV)
        agents = [f"agent{k}" for k in range(num_agents)]
        servos = [[f"{a}/steer_{w}" for w in STEERED] for a in agents]
        self._ctrl = np.array(
            [[self.model.actuator(name).id for name in pair] for pair in servos]
        )
        # A car's bodies follow each other as in the car's own model.
        first = np.array([self.model.body(f"{a}/car").id for a in agents], int)
        self._bodies = np.add.outer(first, np.arange(CAR_BODIES))
        self._start_workers()

    def _start_workers(self) -> None:
        self._own = threading.local()
        self._workers = ThreadPoolExecutor(os.cpu_count())

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in vars(self).items() if k not in ("_own", "_workers")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._start_workers()

    def _addresses(self, field: str, car_size: int) -> np.ndarray:
        """Where agents' blocks, then (x, y, yaw) of parked cars lie in qpos or qvel."""
        table = getattr(self.model, field)
        # The dofs of a car follow each other as in the car's own model.
        roots = [f"agent{k}/root" for k in range(self._num_agents)]
        starts = table[[self.model.joint(name).id for name in roots]]
        parked = [
            table[self.model.joint(f"parked{k}/{axis}").id]
            for k in range(self._num_parked_cars)
            for axis in ("x", "y", "yaw")
        ]
        cars = np.add.outer(starts, np.arange(car_size)).ravel()
        return np.append(cars, np.array(parked, int))

    def advance(
        self,
        moving: Moving,
        qfrc: np.ndarray,
        ctrl: np.ndarray,
        masses: Masses,
        solids: Solids,
    ) -> tuple[Moving, np.ndarray]:
        """Steps a batch of scenes by one substep; any leading shape `(...)`.

        Under forces `qfrc` (..., num_agents, 12) and steering servo targets `ctrl`
        (..., num_agents, 2) [rad].

        Returns:
            Positions and velocities after the substep, and contacts of each agent
            (..., num_agents, num_kinds) bool, see `Motion.touched`.
        """
        arrays = [np.array(x) for x in (*moving, qfrc, ctrl, *masses, *solids)]
        lead = arrays[0].shape[:-2]
        count = math.prod(lead)
        flat = [x.reshape(count, *x.shape[len(lead) :]) for x in arrays]
        touched = np.zeros((count, self._num_agents, self.num_kinds), bool)
        parts = min(count, os.cpu_count() or 1)
        chunks = np.array_split(np.arange(count), parts)
        list(self._workers.map(lambda c: self._advance_some(c, flat, touched), chunks))
        after = (
            x.reshape(old.shape) for x, old in zip(flat[:4], arrays[:4], strict=True)
        )
        return Moving(*after), touched.reshape(*lead, *touched.shape[1:])

    def _advance_some(
        self, scenes: np.ndarray, arrays: list[np.ndarray], touched: np.ndarray
    ) -> None:
        """Steps some scenes, writing the results into the arrays given."""
        qpos, qvel, parked_qpos, parked_qvel, qfrc, ctrl, *rest = arrays
        masses, solids = rest[:3], rest[3:]
        if not hasattr(self._own, "model"):  # masses differ from scene to scene
            self._own.model = copy.copy(self.model)
            self._own.data = mujoco.MjData(self._own.model)
        model, data = self._own.model, self._own.data
        for k in scenes:
            data.qpos[self.qpos_address] = np.append(qpos[k], parked_qpos[k])
            data.qvel[self.qvel_address] = np.append(qvel[k], parked_qvel[k])
            data.qfrc_applied[self.qvel_address[: qfrc[k].size]] = qfrc[k].ravel()
            data.ctrl[self._ctrl] = ctrl[k]
            data.qacc_warmstart[:] = 0.0  # the result depends on the state alone
            for field, value in zip(Masses._fields, masses, strict=True):
                getattr(model, field)[self._bodies] = value[k, :, 1:]
            self.place_movers(model, data, Solids(*(x[k] for x in solids)))
            mujoco.mj_step(model, data)
            _read_back(data.qpos, self.qpos_address, qpos[k], parked_qpos[k])
            _read_back(data.qvel, self.qvel_address, qvel[k], parked_qvel[k])
            self.find_touches(data, touched[k])

    def place_movers(
        self, model: mujoco.MjModel, data: mujoco.MjData, solids: Solids
    ) -> None:
        """Puts the movers' bodies of one scene where `solids` are, and sizes them."""
        position, yaw, size = (np.asarray(x, float) for x in solids)
        still = np.zeros_like(yaw)
        quat = np.stack([np.cos(yaw / 2), still, still, np.sin(yaw / 2)], axis=-1)
        data.mocap_pos[self._mocap], data.mocap_quat[self._mocap] = position, quat
        model.geom_size[self._movers] = size
        # Of a box and of a cylinder; pairs of geoms read no other bound.
        model.geom_rbound[self._movers] = np.linalg.norm(size, axis=-1)

    def find_touches(self, data: mujoco.MjData, touched: np.ndarray) -> None:
        """Marks contacts of agents (num_agents, num_kinds) from those in `data`."""
        if data.ncon == 0:
            return
        first, second = data.contact.geom.T
        for a, b in ((first, second), (second, first)):
            agents = self._kind[a] == ObstacleKind.AGENT
            touched[self._agent[a[agents]], self._kind[b[agents]]] = True


def _read_back(
    values: np.ndarray, address: np.ndarray, cars: np.ndarray, parked: np.ndarray
) -> None:
    """Copies the agents' share of `qpos` or `qvel` and the parked cars' into arrays."""
    cars[:] = values[address[: cars.size]].reshape(cars.shape)
    parked[:] = values[address[cars.size :]].reshape(parked.shape)


def _classify_geoms(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """`ObstacleKind` of each geom, movers apart, and its agent; -1 = none."""
    kind = np.full(model.ngeom, -1)
    agent = np.full(model.ngeom, -1)
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        if found := re.fullmatch(r"agent(\d+)/hull", name):
            kind[geom], agent[geom] = ObstacleKind.AGENT, int(found[1])
        elif name.endswith("/hull"):
            kind[geom] = ObstacleKind.PARKED_CAR
        elif name.startswith(("wall", "disc")):
            kind[geom] = ObstacleKind.WALL
    return kind, agent
