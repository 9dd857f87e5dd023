"""The batched back end: MuJoCo MJX, one 12-dof car per world, brush tyres.

Per car only (qpos, qvel, bristles, steering angle) is carried; the vehicle's
parameters lie in the state too, so a batch may mix cars without recompiling. Without
joint limits and contacts the model has no constraint row, and MJX skips its solver.
"""

import contextlib
import dataclasses
import io
import math
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.geometry import wrap_angle
from carpark_mj.physics.tyres import (
    TyreForces,
    TyreState,
    WheelMotion,
    init_tyres,
    tyre_forces,
)
from carpark_mj.precision import full_float32
from carpark_mj.types import VehicleState
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import STEERED, WHEELS, car_model
from carpark_mj.vehicle.parameters import COMPACT, GRAVITY
from carpark_mj.vehicle.vehicle import Vehicle

with contextlib.redirect_stdout(io.StringIO()):
    # It prints that NVIDIA Warp, which it does not need, is missing.
    from mujoco import mjx


@struct.dataclass
class CarState:
    """Physics state of cars; any leading batch shape.

    Attributes:
        qpos: (..., 13) MuJoCo positions of the 12-dof car.
        qvel: (..., 12) MuJoCo velocities.
        tyres: bristle deflections.
        steering: (...) rate-limited bicycle angle [rad].
        vehicle: parameters.
        trace_w: (..., k, 3) footprint poses within the last control step.
        finite: (...) bool, see `VehicleState.finite`.
    """

    qpos: jax.Array
    qvel: jax.Array
    tyres: TyreState
    steering: jax.Array
    vehicle: Vehicle
    trace_w: jax.Array
    finite: jax.Array


def gravity_vector(sim: SimConfig) -> tuple[float, float, float]:
    """Gravity (3,) [m/s^2] seen from ground of the configured slope, normal to it."""
    normal = math.sqrt(1.0 + sim.grade_x**2 + sim.grade_y**2)
    g = GRAVITY / normal
    return (-g * sim.grade_x, -g * sim.grade_y, -g)


class CarIndex:
    """Addresses of a car's joints in a model, looked up by name once."""

    def __init__(self, model: mujoco.MjModel, prefix: str = "") -> None:
        """Looks the joints of the car with a name prefix up."""

        def joints(kind: str, names: tuple[str, ...]) -> np.ndarray:
            return np.array([model.joint(f"{prefix}{kind}_{n}").id for n in names])

        root = model.joint(f"{prefix}root").id
        steer, spin = joints("steer", STEERED), joints("spin", WHEELS)
        self.root_qpos = int(model.jnt_qposadr[root])
        self.root_dof = int(model.jnt_dofadr[root])
        self.steer_qpos, self.steer_dof = (
            model.jnt_qposadr[steer],
            model.jnt_dofadr[steer],
        )
        self.spin_qpos, self.spin_dof = model.jnt_qposadr[spin], model.jnt_dofadr[spin]


def substep_forces(
    index: CarIndex,
    vehicle: Vehicle,
    qpos: jax.Array,
    qvel: jax.Array,
    tyres: TyreState,
    steering: jax.Array,
    controls: jax.Array,
    dt: float,
) -> tuple[jax.Array, jax.Array, TyreState, jax.Array]:
    """What one car's driver, servos and tyres apply over one substep.

    The same code serves MJX and, as the tests' oracle, plain `mujoco.mj_step`.

    Args:
        index: addresses of the car in `qpos` and `qvel`.
        vehicle: the car.
        qpos: (nq,) positions.
        qvel: (nv,) velocities.
        tyres: bristles.
        steering: () bicycle angle [rad].
        controls: (2,) steer and pedal in [-1, 1].
        dt: substep [s].

    Returns:
        `qfrc_applied` (nv,), servo targets `ctrl` (2,) [rad], the new bristles and the
        new bicycle angle.
    """
    steering = drive.steer_towards(vehicle, steering, controls[0], dt)
    ctrl = drive.ackermann(vehicle, steering)
    rotation = _rotation_matrix(qpos[index.root_qpos + 3 : index.root_qpos + 7])
    speed = rotation[:, 0] @ qvel[index.root_dof : index.root_dof + 3]
    torques = drive.wheel_torques(vehicle, controls[1], speed)
    qfrc, _, tyres = apply_torques(index, vehicle, qpos, qvel, tyres, *torques, dt)
    return qfrc, ctrl, tyres, steering


def apply_torques(
    index: CarIndex,
    vehicle: Vehicle,
    qpos: jax.Array,
    qvel: jax.Array,
    tyres: TyreState,
    torque_drive: jax.Array,
    torque_brake: jax.Array,
    dt: float | jax.Array,
) -> tuple[jax.Array, TyreForces, TyreState]:
    """What the tyres apply to one car over one substep, its wheel torques given.

    Args:
        index: addresses of the car in `qpos` and `qvel`.
        vehicle: the car.
        qpos: (nq,) positions.
        qvel: (nv,) velocities.
        tyres: bristles.
        torque_drive: (4,) drive torque [N m], forwards positive.
        torque_brake: (4,) brake torque [N m], >= 0.
        dt: substep [s].

    Returns:
        `qfrc_applied` (nv,), the tyre forces in it, and the new bristles.
    """
    rotation = _rotation_matrix(qpos[index.root_qpos + 3 : index.root_qpos + 7])
    linear_b = rotation.T @ qvel[index.root_dof : index.root_dof + 3]
    angular_b = qvel[index.root_dof + 3 : index.root_dof + 6]
    motion = _wheel_motion(index, vehicle, qpos, qvel, rotation, linear_b, angular_b)
    forces, tyres = tyre_forces(vehicle, motion, tyres, torque_drive, torque_brake, dt)
    force_b = forces.force_w @ rotation
    contact, _ = _contacts(index, vehicle, qpos, rotation)
    moment_b = jnp.sum(jnp.cross(contact, force_b), axis=0)
    moment_b = moment_b + jnp.array([0.0, 0.0, 1.0]) * jnp.sum(forces.aligning)
    qfrc = jnp.zeros_like(qvel)
    qfrc = qfrc.at[index.root_dof : index.root_dof + 3].set(
        jnp.sum(forces.force_w, axis=0)
    )
    qfrc = qfrc.at[index.root_dof + 3 : index.root_dof + 6].set(moment_b)
    qfrc = qfrc.at[index.steer_dof].set(forces.aligning[:2])
    qfrc = qfrc.at[index.spin_dof].set(forces.spin)
    return qfrc, forces, tyres


def _contacts(
    index: CarIndex, vehicle: Vehicle, qpos: jax.Array, rotation: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Where the tyres meet the ground.

    Returns:
        Contact points (4, 3) in the body frame [m], on the ground: a leaning car does
        not take them with it, or its centre of gravity would stand too high above them
        and it would tip over too early. And how far (4,) the undeflected wheels reach
        above the ground [m].
    """
    undeflected = jnp.pad(vehicle.hub, ((0, 0), (0, 1)))
    height = qpos[index.root_qpos + 2] + undeflected @ rotation[2]
    return undeflected - height[:, None] * rotation[2], height


def _wheel_motion(
    index: CarIndex,
    vehicle: Vehicle,
    qpos: jax.Array,
    qvel: jax.Array,
    rotation: jax.Array,
    linear_b: jax.Array,
    angular_b: jax.Array,
) -> WheelMotion:
    # Velocities are those of the contact patch, where the forces act, so that tyre
    # forces do exactly the work their deflections and losses account for.
    contact, height = _contacts(index, vehicle, qpos, rotation)
    velocity_w = (linear_b + jnp.cross(angular_b, contact)) @ rotation.T
    steer = jnp.pad(qpos[index.steer_qpos], (0, 2))
    steer_rate = jnp.pad(qvel[index.steer_dof], (0, 2))
    heading = rotation[:2, 0]
    heading = heading / jnp.sqrt(jnp.sum(heading**2))
    cos, sin = jnp.cos(steer), jnp.sin(steer)
    along_x = heading[0] * cos - heading[1] * sin
    along_y = heading[1] * cos + heading[0] * sin
    forward = velocity_w[:, 0] * along_x + velocity_w[:, 1] * along_y
    left = velocity_w[:, 1] * along_x - velocity_w[:, 0] * along_y
    return WheelMotion(
        heading_w=jnp.stack([along_x, along_y], axis=-1),
        velocity=jnp.stack([forward, left], axis=-1),
        yaw_rate=angular_b[2] + steer_rate,
        spin=qvel[index.spin_dof],
        sink=-height,
        sink_rate=-velocity_w[:, 2],
    )


def _rotation_matrix(quat: jax.Array) -> jax.Array:
    """Rotation matrix (3, 3), body to world, of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    return jnp.stack(
        [
            jnp.stack(
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
            ),
            jnp.stack(
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
            ),
            jnp.stack(
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
            ),
        ]
    )


class MjxPhysics:
    """MJX with brush tyres behind the `Physics` interface."""

    def __init__(self, sim: SimConfig) -> None:
        """Compiles the car model for the given time steps and slope."""
        self.sim = sim
        model = car_model(COMPACT, sim.sim_dt, gravity_vector(sim))
        if model.nv != 12 or model.njnt != 7:
            raise ValueError(f"the car must have 12 dofs, not {model.nv}")
        self.index = CarIndex(model)
        self._model = mjx.put_model(model)
        self._data = mjx.make_data(model)

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

    def read(self, state: CarState) -> VehicleState:
        """Reads the motion out of fresh `qpos` and `qvel`; see `Physics.read`."""
        return _batched(self._read, state.steering.ndim)(state)

    def _init(self, pose_w: jax.Array, vehicle: Vehicle) -> CarState:
        dtype = pose_w.dtype
        yaw = pose_w[2]
        # The static deflection is inside the vertical spring's preload: z = 0 is rest.
        x = pose_w[0] - vehicle.centre_offset * jnp.cos(yaw)
        y = pose_w[1] - vehicle.centre_offset * jnp.sin(yaw)
        zero = jnp.zeros((), dtype)
        quat = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
        qpos = jnp.concatenate([jnp.stack([x, y, zero]), quat, jnp.zeros(6, dtype)])
        pose = jnp.stack([pose_w[0], pose_w[1], wrap_angle(yaw)])
        return CarState(
            qpos=qpos,
            qvel=jnp.zeros(12, dtype),
            tyres=init_tyres(dtype),
            steering=zero,
            vehicle=vehicle,
            trace_w=jnp.tile(pose, (self.sim.num_traces, 1)),
            finite=jnp.ones((), bool),
        )

    def _step(self, state: CarState, controls: jax.Array) -> CarState:
        vehicle, dt = state.vehicle, self.sim.sim_dt
        model = self._model.tree_replace(
            {
                "body_mass": vehicle.body_mass,
                "body_inertia": vehicle.body_inertia,
                "body_ipos": vehicle.body_ipos,
                "body_pos": vehicle.body_pos,
            }
        )

        def substep(carry, _):
            qpos, qvel, tyres, steering = carry
            with jax.named_scope("tyres"):
                qfrc, ctrl, tyres, steering = substep_forces(
                    self.index, vehicle, qpos, qvel, tyres, steering, controls, dt
                )
            data = self._data.replace(
                qpos=qpos, qvel=qvel, qfrc_applied=qfrc, ctrl=ctrl
            )
            data = mjx.step(model, data)
            return (data.qpos, data.qvel, tyres, steering), None

        def stretch(carry, _):
            stride = self.sim.num_substeps // self.sim.num_traces
            carry, _ = jax.lax.scan(substep, carry, None, length=stride)
            return carry, self._centre_pose(carry[0], vehicle)

        carry = (state.qpos, state.qvel, state.tyres, state.steering)
        (qpos, qvel, tyres, steering), trace = jax.lax.scan(
            stretch, carry, None, length=self.sim.num_traces
        )
        leaves = jax.tree.leaves((qpos, qvel, tyres, steering, trace))
        finite = jnp.stack([jnp.all(jnp.isfinite(x)) for x in leaves]).all()
        stay = jnp.tile(
            self._centre_pose(state.qpos, vehicle), (self.sim.num_traces, 1)
        )
        fallback = dataclasses.replace(
            state,
            qvel=jnp.zeros_like(state.qvel),
            trace_w=stay,
            finite=jnp.zeros((), bool),
        )
        stepped = dataclasses.replace(
            state,
            qpos=qpos,
            qvel=qvel,
            tyres=tyres,
            steering=steering,
            trace_w=trace,
            finite=jnp.ones((), bool),
        )
        return jax.tree.map(partial(jnp.where, finite), stepped, fallback)

    def _read(self, state: CarState) -> VehicleState:
        rotation = _rotation_matrix(state.qpos[3:7])
        velocity_b = rotation.T @ state.qvel[:3]
        return VehicleState(
            pose_w=state.trace_w[-1],
            velocity_b=velocity_b[:2],
            yaw_rate=state.qvel[5],
            steering=state.steering,
            size=state.vehicle.size,
            trace_w=state.trace_w,
            finite=state.finite,
        )

    def _centre_pose(self, qpos: jax.Array, vehicle: Vehicle) -> jax.Array:
        w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
        yaw = jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        return jnp.stack(
            [
                qpos[0] + vehicle.centre_offset * jnp.cos(yaw),
                qpos[1] + vehicle.centre_offset * jnp.sin(yaw),
                wrap_angle(yaw),
            ]
        )


def _batched(function, num_dims: int):
    for _ in range(num_dims):
        function = jax.vmap(function)
    return function
