"""One C MuJoCo model of a whole lot, stepped on the host for a batch of lots.

The numpy side of `carpark_mj.physics.scene`: it knows where each car lies in `qpos`
and which geoms belong to whom, and nothing of tyres or drivers.
"""

import copy
import os
import threading
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.physics.car import gravity_vector
from carpark_mj.scene import build_scene
from carpark_mj.vehicle.parameters import VehicleParameters

CAR_NQ, CAR_NV, CAR_BODIES = 13, 12, 7
_MASSES = ("body_mass", "body_inertia", "body_ipos")
AGENT, PARKED_CAR, WALL = range(3)  # columns of `Motion.touched`


class LotModel:
    """The compiled scene of a lot with brush-tyre cars, hull contacts on.

    Attributes:
        model: the MuJoCo model.
        qpos_address: where the agents' blocks of 13 and then the parked cars' (x, y,
            yaw) lie in `qpos`.
        qvel_address: the same for blocks of 12 in `qvel`.
    """

    def __init__(
        self,
        sim: SimConfig,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
    ) -> None:
        """Compiles the model; arguments as in `ScenePhysics`."""
        self._num_agents = num_agents
        self._num_parked_cars = num_parked_cars
        spec = build_scene(layout, params, num_agents, num_parked_cars)
        spec.option.timestep = sim.sim_dt
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = gravity_vector(sim)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        # A blown-up car must stay visible as non-finite, not be put back silently.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = spec.compile()
        self._kind, self._agent = _classify_geoms(self.model)
        self.qpos_address = self._addresses("jnt_qposadr", CAR_NQ)
        self.qvel_address = self._addresses("jnt_dofadr", CAR_NV)
        self._ctrl = np.array(
            [
                [self.model.actuator(f"agent{k}/steer_{w}").id for w in ("fl", "fr")]
                for k in range(num_agents)
            ]
        )
        # A car's bodies follow each other as in the car's own model.
        self._bodies = np.array(
            [
                self.model.body(f"agent{k}/car").id + np.arange(CAR_BODIES)
                for k in range(num_agents)
            ]
        )
        self._own = threading.local()
        self._workers = ThreadPoolExecutor(os.cpu_count())

    def _addresses(self, field: str, car_size: int) -> np.ndarray:
        """Where the agents' blocks and then the parked cars' lie in qpos or qvel."""
        table = getattr(self.model, field)
        # The dofs of a car follow each other as in the car's own model.
        starts = [
            table[self.model.joint(f"agent{k}/root").id]
            for k in range(self._num_agents)
        ]
        cars = [np.arange(start, start + car_size) for start in starts]
        parked = [
            table[self.model.joint(f"parked{k}/{axis}").id]
            for k in range(self._num_parked_cars)
            for axis in ("x", "y", "yaw")
        ]
        return np.concatenate([*cars, np.array(parked, int)])

    def advance(
        self,
        qpos: np.ndarray,
        qvel: np.ndarray,
        parked_qpos: np.ndarray,
        parked_qvel: np.ndarray,
        qfrc: np.ndarray,
        ctrl: np.ndarray,
        body_mass: np.ndarray,
        body_inertia: np.ndarray,
        body_ipos: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """Steps a batch of lots by one substep; any leading shape `(...)`.

        Args:
            qpos: (..., num_agents, 13).
            qvel: (..., num_agents, 12).
            parked_qpos: (..., num_parked_cars, 3).
            parked_qvel: (..., num_parked_cars, 3).
            qfrc: (..., num_agents, 12) forces applied.
            ctrl: (..., num_agents, 2) steering servo targets [rad].
            body_mass: (..., num_agents, 8) of the bodies of each car alone, the world
                being the first; likewise the next two.
            body_inertia: (..., num_agents, 8, 3).
            body_ipos: (..., num_agents, 8, 3).

        Returns:
            The first four after the substep, and what each agent touched
            (..., num_agents, 3).
        """
        arrays = [
            np.array(x)
            for x in (
                *(qpos, qvel, parked_qpos, parked_qvel, qfrc, ctrl),
                *(body_mass, body_inertia, body_ipos),
            )
        ]
        lead = arrays[0].shape[:-2]
        flat = [x.reshape(-1, *x.shape[len(lead) :]) for x in arrays]
        lots = len(flat[0])
        touched = np.zeros((lots, self._num_agents, 3), bool)
        parts = min(lots, os.cpu_count() or 1)
        chunks = np.array_split(np.arange(lots), parts)
        list(self._workers.map(lambda c: self._advance_lots(c, flat, touched), chunks))
        outputs = [
            x.reshape(old.shape) for x, old in zip(flat[:4], arrays[:4], strict=True)
        ]
        return (*outputs, touched.reshape(*lead, self._num_agents, 3))

    def _advance_lots(
        self, lots: np.ndarray, arrays: list[np.ndarray], touched: np.ndarray
    ) -> None:
        """Steps some lots, writing the results into the arrays given."""
        qpos, qvel, parked_qpos, parked_qvel, qfrc, ctrl, *masses = arrays
        if not hasattr(self._own, "model"):  # masses differ from lot to lot
            self._own.model = copy.copy(self.model)
            self._own.data = mujoco.MjData(self._own.model)
        model, data = self._own.model, self._own.data
        for lot in lots:
            data.qpos[self.qpos_address] = np.append(qpos[lot], parked_qpos[lot])
            data.qvel[self.qvel_address] = np.append(qvel[lot], parked_qvel[lot])
            data.qfrc_applied[self.qvel_address[: qfrc[lot].size]] = qfrc[lot].ravel()
            data.ctrl[self._ctrl] = ctrl[lot]
            data.qacc_warmstart[:] = 0.0  # the result depends on the state alone
            for field, value in zip(_MASSES, masses, strict=True):
                getattr(model, field)[self._bodies] = value[lot, :, 1:]
            mujoco.mj_step(model, data)
            cars = qpos[lot].size  # the agents' share, before the parked cars'
            qpos[lot] = data.qpos[self.qpos_address[:cars]].reshape(qpos[lot].shape)
            parked_qpos[lot] = data.qpos[self.qpos_address[cars:]].reshape(
                parked_qpos[lot].shape
            )
            cars = qvel[lot].size
            qvel[lot] = data.qvel[self.qvel_address[:cars]].reshape(qvel[lot].shape)
            parked_qvel[lot] = data.qvel[self.qvel_address[cars:]].reshape(
                parked_qvel[lot].shape
            )
            self.find_touches(data, touched[lot])

    def find_touches(self, data: mujoco.MjData, touched: np.ndarray) -> None:
        """Marks in (num_agents, 3) whom agents touch by the contacts in `data`."""
        if data.ncon == 0:
            return
        first, second = data.contact.geom.T
        for a, b in ((first, second), (second, first)):
            agents = self._kind[a] == AGENT
            touched[self._agent[a[agents]], self._kind[b[agents]]] = True


def _classify_geoms(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Kind of each geom (`AGENT`... or -1), and the index of its agent (or -1)."""
    kind = np.full(model.ngeom, -1)
    agent = np.full(model.ngeom, -1)
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        if name.endswith("/hull"):
            owner = name.removesuffix("/hull")
            if owner.startswith("agent"):
                kind[geom], agent[geom] = AGENT, int(owner.removeprefix("agent"))
            else:
                kind[geom] = PARKED_CAR
        elif name.startswith(("wall", "disc")):
            kind[geom] = WALL
    return kind, agent
