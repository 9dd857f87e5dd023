"""One C MuJoCo world per lot, in which cars and walls collide.

Agents' cars on brush tyres (the same code as `carpark_mj.physics.mjx`), parked cars
that can be pushed, walls; all hulls collide. Movers are bodies that stop and push
agents' cars. JAX computes the tyres of all cars, a host callback per substep steps the
scenes: slow, to check the factored physics, evaluate by contacts and render crashes.
Wheelbase, track and hull are those of the parameters from which the model was built.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig, SimConfig
from carpark_mj.geometry import move_forward, wrap_angle
from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.obstacles import make_movers, mover_shapes
from carpark_mj.physics import scene_model
from carpark_mj.physics.base import Physics, run_substeps
from carpark_mj.physics.coordinates import CarDynamics, centre_pose, unpack_coordinates
from carpark_mj.physics.forces import substep_forces
from carpark_mj.physics.mjx import CarState, MjxPhysics, contain_cars, started
from carpark_mj.precision import full_float32
from carpark_mj.types import Motion
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.vehicle import Vehicle, in_conditions

MOVED = 1e-3  # m or rad; a parked car set further away than this is moved


@dataclasses.dataclass(frozen=True)
class SceneConfig(PhysicsConfig):
    """The whole lot in one C MuJoCo world."""

    back_end: str = "scene"
    contacts = True

    def check(self, config: EnvConfig) -> None:
        """Refuses long substeps, contact tyres, and cars of several kinds or sizes."""
        config.sim.require_fine_steps()
        if config.sim.tyres == "contact":
            raise ValueError("scene physics has brush tyres only, not contact")
        if config.sim.has_ramp:
            slope = config.sim.ramp[2]
            raise ValueError(f"scene physics has one gravity, no ramp of slope {slope}")
        if config.sim.creep and not config.episode.respawn:
            raise ValueError(
                "sim.creep needs episode.respawn in scene physics, where finished cars "
                "would creep away"
            )
        if config.fleet.is_on or config.jitter.scale != (1.0, 1.0):
            raise ValueError(
                "scene physics has cars of one kind and size, no fleet or jitter.scale"
            )

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> "ScenePhysics":
        """Compiles the scene of the lot."""
        if layout is None:
            raise ValueError(
                f"scene physics needs the same lot for every key, not {config.layout!r}"
            )
        movers = mover_shapes(make_movers(config.movers), layout)
        cars = config.num_agents, config.num_parked_cars
        return ScenePhysics(config.sim, layout, vehicle, *cars, movers)


# Agents' cars, parked_qpos, parked_qvel, touched, number of the substep.
_Carry = tuple[CarDynamics, jax.Array, jax.Array, jax.Array, jax.Array]


@struct.dataclass
class SceneState:
    """Physics state of one lot; leading dimensions of a batch before all of these."""

    cars: CarState  # the agents' cars, (num_agents,)
    parked_set: jax.Array  # (num_parked_cars, 3) footprint poses, as last set
    # (num_parked_cars, 3) rear axles' centres: x, y [m], yaw [rad]
    parked_qpos: jax.Array
    parked_qvel: jax.Array  # (num_parked_cars, 3) their rates
    touched: jax.Array  # (num_agents, k) bool, see `Motion.touched`

    @property
    def vehicle(self) -> Vehicle:
        """Parameters of the agents' cars."""
        return self.cars.vehicle


class ScenePhysics(Physics[SceneState]):
    """One C MuJoCo world per lot behind the `Physics` interface."""

    config = PHYSICS.register("scene", SceneConfig())

    def __init__(
        self,
        sim: SimConfig,
        layout: Layout,
        params: VehicleParameters,
        num_agents: int,
        num_parked_cars: int,
        movers: Sequence[Group] = (),
    ) -> None:
        """Compiles the model of a lot, which all lots of a batch have.

        `movers` are groups of obstacles that move by themselves, or their shapes.
        """
        self.sim = sim
        self._single = MjxPhysics(sim)
        self._num_parked_cars = num_parked_cars
        self._centre_offset = params.centre_offset
        self._counts = [group.count for group in movers]
        self.scene = scene_model.SceneModel(
            sim, layout, params, num_agents, num_parked_cars, movers
        )

    @full_float32
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> SceneState:
        """Cars at rest, no parked car placed yet; see `Physics.init`."""
        lead = pose_w.shape[:-2]
        parked = jnp.zeros((*lead, self._num_parked_cars, 3), pose_w.dtype)
        return SceneState(
            cars=self._single.init(pose_w, vehicle),
            # Nowhere, so that the first `set_parked_poses` moves them all.
            parked_set=jnp.full_like(parked, jnp.inf),
            parked_qpos=parked,
            parked_qvel=parked,
            touched=jnp.zeros((*pose_w.shape[:-1], self.scene.num_kinds), bool),
        )

    def set_speed(self, state: SceneState, speed: jax.Array) -> SceneState:
        """Agents' cars (...) rolling straight on at speeds (...) [m/s]."""
        cars = self._single.set_speed(state.cars, speed)
        return dataclasses.replace(state, cars=cars)

    def place(
        self, state: SceneState, mask: jax.Array, pose_w: jax.Array, vehicle: Vehicle
    ) -> SceneState:
        """Places some cars at new poses, at rest; see `Physics.place`."""
        return dataclasses.replace(
            state,
            cars=self._single.place(state.cars, mask, pose_w, vehicle),
            touched=state.touched & ~mask[..., None],
        )

    @full_float32
    def set_parked_poses(self, state: SceneState, parked_pose: jax.Array) -> SceneState:
        """Places parked cars whose pose changed; see `Physics.set_parked_poses`."""
        moved = jnp.abs(parked_pose - state.parked_set).max(-1, keepdims=True) > MOVED
        rear = move_forward(parked_pose, -self._centre_offset)
        return dataclasses.replace(
            state,
            parked_set=parked_pose,
            parked_qpos=jnp.where(moved, rear, state.parked_qpos),
            parked_qvel=jnp.where(moved, 0.0, state.parked_qvel),
        )

    def parked_poses(self, state: SceneState, intended: jax.Array) -> jax.Array:
        """Poses (..., num_parked_cars, 3) of the footprints, pushed or not."""
        centre = move_forward(state.parked_qpos, self._centre_offset)
        return centre.at[..., 2].set(wrap_angle(centre[..., 2]))

    def read(self, state: SceneState) -> Motion:
        """Reads the motion and the contacts; see `Physics.read`."""
        motion = self._single.read(state.cars)
        return dataclasses.replace(motion, touched=state.touched)

    @full_float32
    def step(self, state: SceneState, controls: jax.Array) -> SceneState:
        """Advances one lot by one control step; batches by `jax.vmap`.

        Its movers are absent.
        """
        nobody = scene_model.absent(sum(self._counts))
        with jax.named_scope("physics"):
            return self._step(state, controls, lambda left, pose_w: nobody)

    @full_float32
    def step_among(
        self,
        state: SceneState,
        controls: jax.Array,
        before: Sequence[Group],
        after: Sequence[Group],
    ) -> SceneState:
        """Advances one lot among movers; see `Physics.step_among`."""
        counts = [group.count for group in after]
        if counts != self._counts:
            raise ValueError(
                f"scene physics was made for {self._counts} movers, not {counts}"
            )
        with jax.named_scope("physics"):
            size = state.vehicle.size
            movers = partial(scene_model.solids_within, before, after, size=size)
            return self._step(state, controls, movers)

    def _step(
        self,
        state: SceneState,
        controls: jax.Array,
        movers: Callable[[jax.Array, jax.Array], scene_model.Solids],
    ) -> SceneState:
        """Advances one lot.

        `movers` are told the share () of the step that is left and the poses
        (num_agents, 3) of cars.
        """
        cars = state.cars
        vehicle = in_conditions(state.vehicle, self.sim)
        masses = scene_model.Masses(
            vehicle.body_mass, vehicle.body_inertia, vehicle.body_ipos
        )
        index = self._single.index
        forces = partial(substep_forces, index, dt=self.sim.sim_dt)

        def poses(carry: _Carry) -> jax.Array:
            at = unpack_coordinates(index, carry[0].qpos, carry[0].qvel)
            return centre_pose(at, vehicle)

        def substep(carry: _Carry) -> _Carry:
            car, parked_qpos, parked_qvel, touched, number = carry
            solids = movers(1.0 - number / self.sim.num_substeps, poses(carry))
            qfrc, ctrl, tyres, actuators = forces(vehicle, car, controls)
            moving = scene_model.Moving(car.qpos, car.qvel, parked_qpos, parked_qvel)
            shapes = jax.tree.map(
                lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (moving, touched)
            )
            moving, hit = jax.pure_callback(
                self.scene.advance,
                shapes,
                *(moving, qfrc, ctrl, masses, solids),
                vmap_method="broadcast_all",
            )
            qpos, qvel, parked_qpos, parked_qvel = moving
            car = CarDynamics(qpos, qvel, tyres, actuators)
            return car, parked_qpos, parked_qvel, touched | hit, number + 1

        car = started(self.sim, cars, controls)
        nothing = jnp.zeros_like(state.touched), jnp.int32(0)
        carry = car, state.parked_qpos, state.parked_qvel, *nothing
        carry, trace = run_substeps(self.sim, substep, carry, poses)
        car, parked_qpos, parked_qvel, touched, _ = carry
        finite = jnp.isfinite(parked_qpos)
        return SceneState(
            cars=contain_cars(cars, car, jnp.moveaxis(trace, 0, 1)),
            parked_set=state.parked_set,
            parked_qpos=jnp.where(finite, parked_qpos, state.parked_qpos),
            parked_qvel=jnp.where(jnp.isfinite(parked_qvel), parked_qvel, 0.0),
            touched=touched,
        )
