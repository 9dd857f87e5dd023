"""The batched back end: MuJoCo MJX, one 12-dof car per world, brush tyres.

Per car only (qpos, qvel, bristles, actuators) is carried; the vehicle's
parameters lie in the state too, so a batch may mix cars without recompiling. Without
joint limits and contacts the model has no constraint row, and MJX skips its solver.
"""

import contextlib
import dataclasses
import io

import jax
import jax.numpy as jnp
import mujoco
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.geometry import wrap_angle
from carpark_mj.physics.base import (
    FactoredPhysics,
    contain_non_finite,
    run_substeps,
)
from carpark_mj.physics.car import (
    CarDynamics,
    CarIndex,
    centre_pose,
    gravity_vector,
    rotation_matrix,
    substep_forces,
)
from carpark_mj.physics.tyres import TyreState, init_tyres
from carpark_mj.precision import full_float32
from carpark_mj.types import Motion
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.presets import COMPACT
from carpark_mj.vehicle.surfaces import on_surface
from carpark_mj.vehicle.vehicle import Vehicle

with contextlib.redirect_stdout(io.StringIO()):
    # It prints that NVIDIA Warp, which it does not need, is missing.
    from mujoco import mjx


@struct.dataclass
class CarState:
    """Physics state of cars; any leading batch shape.

    Attributes:
        qpos: (..., 13) MuJoCo positions of the 12-dof car; 17 with a suspension.
        qvel: (..., 12) MuJoCo velocities; 16 with a suspension.
        tyres: bristle deflections.
        actuators: state of steering and drive.
        vehicle: parameters.
        trace_w: (..., k, 3) footprint poses within the last control step.
        finite: (...) bool, see `Motion.finite`.
    """

    qpos: jax.Array
    qvel: jax.Array
    tyres: TyreState
    actuators: drive.Actuators
    vehicle: Vehicle
    trace_w: jax.Array
    finite: jax.Array


class MjxPhysics(FactoredPhysics[CarState]):
    """MJX with brush tyres behind the `Physics` interface."""

    def __init__(self, sim: SimConfig) -> None:
        """Compiles the car model for the given time steps, slope and surface."""
        self.sim = sim
        model = self._compile(sim)
        self._nv = 16 if sim.suspension else 12
        if model.nv != self._nv or model.njnt != self._nv - 5:
            raise ValueError(f"the car must have {self._nv} dofs, not {model.nv}")
        self.index = CarIndex(model)
        self._model = mjx.put_model(model)
        self._data = mjx.make_data(model)

    def _compile(self, sim: SimConfig) -> mujoco.MjModel:
        """The model of one car; what a batch may mix is replaced in `_step`."""
        return car_model(COMPACT, sim.sim_dt, gravity_vector(sim))

    @full_float32
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> CarState:
        """Cars at rest on relaxed tyres; see `Physics.init`."""
        return _batched(self._init, pose_w.ndim - 1)(pose_w, vehicle)

    @full_float32
    def step(self, state: CarState, controls: jax.Array) -> CarState:
        """Advances by one control step; see `Physics.step`.

        A car with a non-finite number in its state is put back to where it was before
        the step, at rest on the position it had, and flagged.
        """
        with jax.named_scope("physics"):
            return _batched(self._step, controls.ndim - 1)(state, controls)

    def read(self, state: CarState) -> Motion:
        """Reads the motion out of fresh `qpos` and `qvel`; see `Physics.read`."""
        return _batched(self._read, state.finite.ndim)(state)

    def _init(self, pose_w: jax.Array, vehicle: Vehicle) -> CarState:
        dtype = pose_w.dtype
        yaw = pose_w[2]
        # The static deflection is inside the vertical spring's preload: z = 0 is rest.
        x = pose_w[0] - vehicle.centre_offset * jnp.cos(yaw)
        y = pose_w[1] - vehicle.centre_offset * jnp.sin(yaw)
        zero = jnp.zeros((), dtype)
        quat = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
        qpos = jnp.concatenate(
            [jnp.stack([x, y, zero]), quat, jnp.zeros(self._nv - 6, dtype)]
        )
        pose = jnp.stack([pose_w[0], pose_w[1], wrap_angle(yaw)])
        return CarState(
            qpos=qpos,
            qvel=jnp.zeros(self._nv, dtype),
            tyres=init_tyres(dtype),
            actuators=drive.init_actuators(dtype),
            vehicle=vehicle,
            trace_w=jnp.tile(pose, (self.sim.num_traces, 1)),
            finite=jnp.ones((), bool),
        )

    def _step(self, state: CarState, controls: jax.Array) -> CarState:
        vehicle = on_surface(state.vehicle, self.sim.surface)
        model = self._model.tree_replace(
            {
                "body_mass": vehicle.body_mass,
                "body_inertia": vehicle.body_inertia,
                "body_ipos": vehicle.body_ipos,
                "body_pos": vehicle.body_pos,
            }
        )

        def substep(car: CarDynamics) -> CarDynamics:
            return self._substep(model, vehicle, controls, car)

        car, trace = run_substeps(
            self.sim,
            substep,
            CarDynamics(state.qpos, state.qvel, state.tyres, state.actuators),
            lambda car: centre_pose(car.qpos, vehicle),
        )
        return contain_cars(state, car, trace)

    def _substep(
        self,
        model: mjx.Model,
        vehicle: Vehicle,
        controls: jax.Array,
        car: CarDynamics,
    ) -> CarDynamics:
        """Advances one car by one substep."""
        with jax.named_scope("tyres"):
            qfrc, ctrl, tyres, actuators = substep_forces(
                self.index, vehicle, car, controls, self.sim.sim_dt
            )
        data = self._data.replace(
            qpos=car.qpos, qvel=car.qvel, qfrc_applied=qfrc, ctrl=ctrl
        )
        data = mjx.step(model, data)
        return CarDynamics(data.qpos, data.qvel, tyres, actuators)

    def _read(self, state: CarState) -> Motion:
        rotation = rotation_matrix(state.qpos[3:7])
        velocity_b = rotation.T @ state.qvel[:3]
        return Motion(
            pose_w=state.trace_w[-1],
            velocity_b=velocity_b[:2],
            yaw_rate=state.qvel[5],
            steering=state.actuators.steering,
            size=state.vehicle.size,
            trace_w=state.trace_w,
            finite=state.finite,
        )


def contain_cars(before: CarState, car: CarDynamics, trace_w: jax.Array) -> CarState:
    """Cars (...) after a step; those with a non-finite number are put back, at rest.

    Args:
        before: the cars before the step.
        car: what the step computed.
        trace_w: (..., k, 3) poses within the step.
    """
    pose = _batched(centre_pose, before.finite.ndim)(before.qpos, before.vehicle)
    at_rest = dataclasses.replace(
        before,
        qvel=jnp.zeros_like(before.qvel),
        trace_w=jnp.broadcast_to(pose[..., None, :], before.trace_w.shape),
        finite=jnp.zeros_like(before.finite),
    )
    stepped = dataclasses.replace(
        before, **car._asdict(), trace_w=trace_w, finite=jnp.ones_like(before.finite)
    )
    return contain_non_finite((car, trace_w), stepped, at_rest)


def _batched(function, num_dims: int):
    for _ in range(num_dims):
        function = jax.vmap(function)
    return function
