"""One C MuJoCo world per lot, in which cars and walls collide.

Agents' cars on brush tyres (the same code as `carpark_mj.physics.mjx`), parked cars
that can be pushed, walls; all hulls collide. Movers are bodies that stop and push
agents' cars. JAX computes the tyres of all cars, a host callback per substep steps the
scenes. It is slow and serves to check the factored physics, to evaluate by contacts and
to render crashes.

Every car follows its own `Vehicle`, as in `mjx`, except for wheelbase, track and hull:
they are those of the parameters from which the model was built.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig, SimConfig
from carpark_mj.geometry import move_forward, wrap_angle
from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.obstacles import make_movers, mover_shapes
from carpark_mj.physics.base import Physics, run_substeps
from carpark_mj.physics.coordinates import CarDynamics, centre_pose, unpack_coordinates
from carpark_mj.physics.forces import substep_forces
from carpark_mj.physics.mjx import CarState, MjxPhysics, contain_cars, started
from carpark_mj.physics.scene_model import (
    Masses,
    Moving,
    SceneModel,
    Solids,
    absent,
    solids_within,
)
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
            raise ValueError(
                "scene physics has one gravity for the whole lot: sim.ramp must have "
                f"slope 0, not {config.sim.ramp[2]}; use mjx"
            )
        if config.sim.creep and not config.episode.respawn:
            raise ValueError(
                "scene physics goes on moving cars that have finished, which would "
                "creep away: sim.creep needs episode.respawn = True there"
            )
        if config.fleet.is_on or config.jitter.scale != (1.0, 1.0):
            raise ValueError(
                "scene physics has cars of one kind and size only, no fleet and no "
                "jitter.scale: use mjx"
            )

    def make(
        self, config: EnvConfig, layout: Layout | None, vehicle: VehicleParameters
    ) -> "ScenePhysics":
        """Compiles the scene of the lot."""
        if layout is None:
            raise ValueError(
                f"scene physics needs the same lot for every key, not {config.layout!r}"
            )
        return ScenePhysics(
            config.sim,
            layout,
            vehicle,
            config.num_agents,
            config.num_parked_cars,
            mover_shapes(make_movers(config.movers), layout),
        )


# Agents' cars, parked_qpos, parked_qvel, touched, number of the substep.
_Carry = tuple[CarDynamics, jax.Array, jax.Array, jax.Array, jax.Array]


@struct.dataclass
class SceneState:
    """Physics state of one lot; leading dimensions of a batch before all of these.

    Attributes:
        cars: the agents' cars, (num_agents,).
        parked_set: (num_parked_cars, 3) footprint poses, as last set.
        parked_qpos: (num_parked_cars, 3) rear axles' centres: x, y [m], yaw [rad].
        parked_qvel: (num_parked_cars, 3) their rates.
        touched: (num_agents, k) bool, see `Motion.touched`.
    """

    cars: CarState
    parked_set: jax.Array
    parked_qpos: jax.Array
    parked_qvel: jax.Array
    touched: jax.Array

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
        """Compiles the model of a lot.

        Args:
            sim: time steps and slope.
            layout: the lot; all lots of a batch have this one.
            params: the vehicle of all cars.
            num_agents: agents.
            num_parked_cars: parked cars.
            movers: the groups of obstacles that move by themselves, or their shapes.
        """
        self.sim = sim
        self._single = MjxPhysics(sim)
        self._num_agents = num_agents
        self._num_parked_cars = num_parked_cars
        self._centre_offset = params.centre_offset
        self._counts = [group.count for group in movers]
        self.scene = SceneModel(
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
        return dataclasses.replace(
            state, cars=self._single.set_speed(state.cars, speed)
        )

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
        del intended
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
        nobody = absent(sum(self._counts))
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
        """Advances one lot among movers; see `Physics.step_among`.

        Raises:
            ValueError: there are other numbers of movers than the scene was made for.
        """
        counts = [group.count for group in after]
        if counts != self._counts:
            raise ValueError(
                f"the lot has groups of {counts} movers, scene physics was made for "
                f"{self._counts}: give ScenePhysics those of the lot"
            )
        with jax.named_scope("physics"):
            size = state.vehicle.size
            movers = partial(solids_within, before, after, size=size)
            return self._step(state, controls, movers)

    def _step(
        self,
        state: SceneState,
        controls: jax.Array,
        movers: Callable[[jax.Array, jax.Array], Solids],
    ) -> SceneState:
        """Advances one lot.

        Args:
            state: current state.
            controls: of the cars.
            movers: when a share () of the step is left and cars are at poses
                (num_agents, 3).
        """
        cars = state.cars
        vehicle = in_conditions(state.vehicle, self.sim)
        masses = Masses(vehicle.body_mass, vehicle.body_inertia, vehicle.body_ipos)
        index = self._single.index
        forces = partial(substep_forces, index, dt=self.sim.sim_dt)

        def poses(carry: _Carry) -> jax.Array:
            at = unpack_coordinates(index, carry[0].qpos, carry[0].qvel)
            return centre_pose(at, vehicle)

        def substep(carry: _Carry) -> _Carry:
            car, parked_qpos, parked_qvel, touched, number = carry
            solids = movers(1.0 - number / self.sim.num_substeps, poses(carry))
            qfrc, ctrl, tyres, actuators = forces(vehicle, car, controls)
            moving = Moving(car.qpos, car.qvel, parked_qpos, parked_qvel)
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

        carry, trace = run_substeps(
            self.sim,
            substep,
            (
                started(self.sim, cars, controls),
                state.parked_qpos,
                state.parked_qvel,
                jnp.zeros_like(state.touched),
                jnp.int32(0),
            ),
            poses,
        )
        car, parked_qpos, parked_qvel, touched, _ = carry
        return SceneState(
            cars=contain_cars(cars, car, jnp.moveaxis(trace, 0, 1)),
            parked_set=state.parked_set,
            parked_qpos=jnp.where(
                jnp.isfinite(parked_qpos), parked_qpos, state.parked_qpos
            ),
            parked_qvel=jnp.where(jnp.isfinite(parked_qvel), parked_qvel, 0.0),
            touched=touched,
        )
