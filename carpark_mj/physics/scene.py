"""The judge: the whole lot as one C MuJoCo model in which everything touches.

Agents' cars on brush tyres (the same code as `carpark_mj.physics.mjx`), parked cars
that can be pushed, walls; all hulls collide. JAX computes the tyres of all cars, a
host callback per substep steps the lots' models. It is slow and meant for checking the
factored physics, for evaluation by contacts, and for filming crashes.

All cars of a lot have the masses of the preset the model was built from; tyres, drive
and brakes follow each car's `Vehicle`, as in `mjx`.
"""

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.geometry import wrap_angle
from carpark_mj.layouts.types import Layout
from carpark_mj.physics.mjx import (
    CarIndex,
    CarState,
    MjxPhysics,
    centre_pose,
    gravity_vector,
    substep_forces,
)
from carpark_mj.precision import full_float32
from carpark_mj.scene import build_scene
from carpark_mj.types import VehicleState
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.vehicle import Vehicle

CAR_NQ, CAR_NV = 13, 12
AGENT, PARKED_CAR, WALL = range(3)  # columns of `VehicleState.touched`
MOVED = 1e-3  # m or rad, by which `arrange` knows a parked car stands elsewhere


@struct.dataclass
class SceneState:
    """Physics state of one lot; leading dimensions of a batch before all of these.

    Attributes:
        cars: the agents' cars, (num_agents,).
        parked_told: (num_parked_cars, 3) footprint poses last given to `arrange`.
        parked_qpos: (num_parked_cars, 3) x, y [m], yaw [rad] of the rear axles' centres.
        parked_qvel: (num_parked_cars, 3) their rates.
        touched: (num_agents, 3) bool, see `VehicleState.touched`.
    """

    cars: CarState
    parked_told: jax.Array
    parked_qpos: jax.Array
    parked_qvel: jax.Array
    touched: jax.Array

    @property
    def vehicle(self) -> Vehicle:
        """Parameters of the agents' cars."""
        return self.cars.vehicle


class ScenePhysics:
    """One C MuJoCo world per lot behind the `Physics` interface."""

    contacts = True

    def __init__(
        self,
        sim: SimConfig,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
    ) -> None:
        """Compiles the model of a lot.

        Args:
            sim: time steps and slope.
            layout: the lot; all lots of a batch have this one.
            params: the vehicle of all cars.
            num_agents: agents.
            num_parked_cars: parked cars.
        """
        self.sim = sim
        self._single = MjxPhysics(sim)
        self._num_agents = num_agents
        self._num_parked_cars = num_parked_cars
        self._centre_offset = params.centre_offset
        spec = build_scene(layout, params, num_agents, num_parked_cars)
        spec.option.timestep = sim.sim_dt
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = gravity_vector(sim)
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        # A blown-up car must stay visible as non-finite, not be put back silently.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = spec.compile()
        self._kind, self._agent = _classify_geoms(self.model)
        self._qpos = self._addresses("jnt_qposadr", CAR_NQ)
        self._qvel = self._addresses("jnt_dofadr", CAR_NV)
        self._ctrl = np.array(
            [
                [self.model.actuator(f"agent{k}/steer_{w}").id for w in ("fl", "fr")]
                for k in range(num_agents)
            ]
        )
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

    @full_float32
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> SceneState:
        """Cars at rest, no parked car placed yet; see `Physics.init`."""
        lead = pose_w.shape[:-2]
        parked = jnp.zeros((*lead, self._num_parked_cars, 3), pose_w.dtype)
        return SceneState(
            cars=self._single.init(pose_w, vehicle),
            # Nowhere, so that the first `arrange` moves them all.
            parked_told=jnp.full_like(parked, jnp.inf),
            parked_qpos=parked,
            parked_qvel=parked,
            touched=jnp.zeros((*pose_w.shape[:-1], 3), bool),
        )

    def place(
        self, state: SceneState, mask: jax.Array, pose_w: jax.Array
    ) -> SceneState:
        """Puts some cars elsewhere, at rest; see `Physics.place`."""
        return dataclasses.replace(
            state,
            cars=self._single.place(state.cars, mask, pose_w),
            touched=state.touched & ~mask[..., None],
        )

    @full_float32
    def arrange(self, state: SceneState, parked_pose: jax.Array) -> SceneState:
        """Puts parked cars told to stand elsewhere there; see `Physics.arrange`."""
        moved = jnp.abs(parked_pose - state.parked_told).max(-1, keepdims=True) > MOVED
        x, y, yaw = (parked_pose[..., k] for k in range(3))
        rear = jnp.stack(
            [
                x - self._centre_offset * jnp.cos(yaw),
                y - self._centre_offset * jnp.sin(yaw),
                yaw,
            ],
            axis=-1,
        )
        return dataclasses.replace(
            state,
            parked_told=parked_pose,
            parked_qpos=jnp.where(moved, rear, state.parked_qpos),
            parked_qvel=jnp.where(moved, 0.0, state.parked_qvel),
        )

    def parked_pose(self, state: SceneState) -> jax.Array:
        """Footprint poses (num_parked_cars, 3) of the parked cars, pushed or not."""
        x, y, yaw = (state.parked_qpos[..., k] for k in range(3))
        return jnp.stack(
            [
                x + self._centre_offset * jnp.cos(yaw),
                y + self._centre_offset * jnp.sin(yaw),
                wrap_angle(yaw),
            ],
            axis=-1,
        )

    def read(self, state: SceneState) -> VehicleState:
        """Reads the motion and what was touched; see `Physics.read`."""
        vehicle = self._single.read(state.cars)
        return dataclasses.replace(vehicle, touched=state.touched)

    @full_float32
    def step(self, state: SceneState, controls: jax.Array) -> SceneState:
        """Advances one lot by one control step; batches by `jax.vmap`."""
        with jax.named_scope("physics"):
            return self._step(state, controls)

    def _step(self, state: SceneState, controls: jax.Array) -> SceneState:
        cars, vehicle, dt = state.cars, state.vehicle, self.sim.sim_dt
        forces = jax.vmap(
            partial(substep_forces, self._single.index, dt=dt),
        )

        def substep(carry, _):
            qpos, qvel, tyres, steering, parked_qpos, parked_qvel, touched = carry
            qfrc, ctrl, tyres, steering = forces(
                vehicle, qpos, qvel, tyres, steering, controls
            )
            moving = (qpos, qvel, parked_qpos, parked_qvel)
            shapes = jax.tree.map(
                lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), moving
            )
            *moving, hit = jax.pure_callback(
                self._advance,
                (*shapes, jax.ShapeDtypeStruct(touched.shape, touched.dtype)),
                *moving,
                qfrc,
                ctrl,
                vmap_method="broadcast_all",
            )
            qpos, qvel, parked_qpos, parked_qvel = moving
            carry = (qpos, qvel, tyres, steering, parked_qpos, parked_qvel)
            return (*carry, touched | hit), None

        def stretch(carry, _):
            stride = self.sim.num_substeps // self.sim.num_traces
            carry, _ = jax.lax.scan(substep, carry, None, length=stride)
            return carry, jax.vmap(centre_pose)(carry[0], vehicle)

        carry = (
            cars.qpos,
            cars.qvel,
            cars.tyres,
            cars.steering,
            state.parked_qpos,
            state.parked_qvel,
            jnp.zeros_like(state.touched),
        )
        carry, trace = jax.lax.scan(stretch, carry, None, length=self.sim.num_traces)
        qpos, qvel, tyres, steering, parked_qpos, parked_qvel, touched = carry
        stepped = dataclasses.replace(
            cars,
            qpos=qpos,
            qvel=qvel,
            tyres=tyres,
            steering=steering,
            trace_w=jnp.moveaxis(trace, 0, 1),
            finite=jnp.ones_like(cars.finite),
        )
        return SceneState(
            cars=self._contain(cars, stepped),
            parked_told=state.parked_told,
            parked_qpos=jnp.where(
                jnp.isfinite(parked_qpos), parked_qpos, state.parked_qpos
            ),
            parked_qvel=jnp.where(jnp.isfinite(parked_qvel), parked_qvel, 0.0),
            touched=touched,
        )

    def _contain(self, before: CarState, after: CarState) -> CarState:
        """Puts cars with a non-finite number back to where they were, flagged."""
        leaves = jax.tree.leaves(
            (after.qpos, after.qvel, after.tyres, after.steering, after.trace_w)
        )
        finite = jnp.stack(
            [jnp.isfinite(x).reshape(self._num_agents, -1).all(axis=1) for x in leaves]
        ).all(axis=0)
        here = jax.vmap(centre_pose)(before.qpos, before.vehicle)
        fallback = dataclasses.replace(
            before,
            qvel=jnp.zeros_like(before.qvel),
            trace_w=jnp.broadcast_to(here[:, None], before.trace_w.shape),
            finite=jnp.zeros_like(finite),
        )

        def select(new: jax.Array, old: jax.Array) -> jax.Array:
            keep = jnp.expand_dims(finite, range(1, new.ndim))
            return jnp.where(keep, new, old)

        return jax.tree.map(select, after, fallback)

    def _advance(
        self,
        qpos: np.ndarray,
        qvel: np.ndarray,
        parked_qpos: np.ndarray,
        parked_qvel: np.ndarray,
        qfrc: np.ndarray,
        ctrl: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """Steps the models of a batch of lots by one substep, on the host."""
        arrays = [
            np.array(x) for x in (qpos, qvel, parked_qpos, parked_qvel, qfrc, ctrl)
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
        qpos, qvel, parked_qpos, parked_qvel, qfrc, ctrl = arrays
        data = mujoco.MjData(self.model)
        for lot in lots:
            data.qpos[self._qpos] = np.append(qpos[lot], parked_qpos[lot])
            data.qvel[self._qvel] = np.append(qvel[lot], parked_qvel[lot])
            data.qfrc_applied[self._qvel[: qfrc[lot].size]] = qfrc[lot].ravel()
            data.ctrl[self._ctrl] = ctrl[lot]
            data.qacc_warmstart[:] = 0.0  # the result depends on the state alone
            mujoco.mj_step(self.model, data)
            cars = qpos[lot].size
            qpos[lot].flat = data.qpos[self._qpos[:cars]]
            parked_qpos[lot].flat = data.qpos[self._qpos[cars:]]
            cars = qvel[lot].size
            qvel[lot].flat = data.qvel[self._qvel[:cars]]
            parked_qvel[lot].flat = data.qvel[self._qvel[cars:]]
            self._find_touches(data, touched[lot])

    def _find_touches(self, data: mujoco.MjData, touched: np.ndarray) -> None:
        if data.ncon == 0:
            return
        first, second = data.contact.geom.T
        for a, b in ((first, second), (second, first)):
            agents = self._kind[a] == AGENT
            touched[self._agent[a[agents]], self._kind[b[agents]]] = True


def _classify_geoms(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Kind of each geom (`AGENT`, `PARKED_CAR`, `WALL`, or -1), and its agent's index."""
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
        elif name.startswith("wall"):
            kind[geom] = WALL
    return kind, agent
