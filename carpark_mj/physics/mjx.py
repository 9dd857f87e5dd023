"""The batched back end: one 12-dof car per world, MuJoCo's model and equations.

The state of a car is qpos, qvel, bristles, actuators and the vehicle's parameters, so a
batch may mix cars without recompiling. The unrolled equations step cars where the model
allows, otherwise `mjx.step` does; `SimConfig.stepper` can force either.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from flax import struct

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig, SimConfig
from carpark_mj.extensions import Entry
from carpark_mj.geometry import wrap_angle
from carpark_mj.physics.base import Physics, contain_non_finite, where_cars
from carpark_mj.physics.coordinates import (
    CarDynamics,
    CarIndex,
    TyreState,
    column,
    dot,
    init_tyres,
    unpack_coordinates,
)
from carpark_mj.physics.forces import gravity_vector
from carpark_mj.physics.unrolled import UnrolledStep
from carpark_mj.precision import full_float32
from carpark_mj.types import Motion
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import car_model
from carpark_mj.vehicle.presets import COMPACT
from carpark_mj.vehicle.vehicle import Vehicle, in_conditions

# They import MJX, which is slow, and this module.
_CONTACT = Entry("carpark_mj.physics.mjx_step:ContactPhysics")
_STEP = Entry("carpark_mj.physics.mjx_step:MjxStep")
LEAST_UP = 0.5  # cosine of the lean at which a car has overturned: 60 degrees

Step = Callable[[Vehicle, CarDynamics, jax.Array], tuple[CarDynamics, jax.Array]]
Stepper = Callable[[mujoco.MjModel, SimConfig], Step]


@dataclasses.dataclass(frozen=True)
class MjxConfig(PhysicsConfig):
    """Rigid-body cars on tyres, each simulated on its own."""

    back_end: str = "mjx"

    def check(self, config: EnvConfig) -> None:
        """Refuses substeps too long for the tyres."""
        config.sim.require_fine_steps()

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> "MjxPhysics":
        """Builds it with the tyres of `SimConfig.tyres`."""
        if config.sim.tyres == "contact":
            return _CONTACT.load()(config.sim)
        return MjxPhysics(config.sim)


@struct.dataclass
class CarState:
    """Physics state of cars; any leading batch shape."""

    # (..., 13) MuJoCo positions of the 12-dof car; 17 with a suspension
    qpos: jax.Array
    qvel: jax.Array  # (..., 12) MuJoCo velocities; 16 with a suspension
    tyres: TyreState  # bristle deflections (..., 4)
    actuators: drive.Actuators  # state of steering and drive
    vehicle: Vehicle  # parameters
    trace_w: jax.Array  # (..., k, 3) footprint poses within the last control step
    finite: jax.Array  # (...) bool, see `Motion.finite`


class MjxPhysics(Physics[CarState]):
    """Cars on brush tyres behind the `Physics` interface."""

    config = PHYSICS.register("mjx", MjxConfig())

    def __init__(self, sim: SimConfig) -> None:
        """Compiles the car model for the given time steps, slope and surface."""
        sim.require_fine_steps()
        self.sim = sim
        model, make_stepper = self._compile(sim)
        self.index = CarIndex(model)
        self._nq, self._nv = model.nq, model.nv
        self._step = make_stepper(model, sim)

    def _compile(self, sim: SimConfig) -> tuple[mujoco.MjModel, Stepper]:
        """The model of one car, whose parameters every step replaces, and its step."""
        model = car_model(COMPACT, sim.sim_dt, gravity_vector(sim))
        return model, UnrolledStep if sim.stepper != "mjx" else _STEP.load()

    @full_float32
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> CarState:
        """Cars at rest on relaxed tyres; see `Physics.init`."""
        lead, dtype, yaw = pose_w.shape[:-1], pose_w.dtype, pose_w[..., 2]
        # The static deflection is inside the vertical spring's preload: z = 0 is rest.
        x = pose_w[..., 0] - vehicle.centre_offset * jnp.cos(yaw)
        y = pose_w[..., 1] - vehicle.centre_offset * jnp.sin(yaw)
        zero = jnp.zeros(lead, dtype)
        rest = [zero] * (self._nq - 7)
        quat = [jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)]
        pose = jnp.stack([pose_w[..., 0], pose_w[..., 1], wrap_angle(yaw)], -1)
        shape = (*lead, self.sim.num_traces, 3)
        actuators = drive.init_actuators(vehicle)
        if self.sim.steering_delay or self.sim.pedal_delay:
            lines = drive.make_lines(self.sim, zero)
            actuators = dataclasses.replace(actuators, lines=lines)
        return CarState(
            qpos=jnp.stack([x, y, zero, *quat, *rest], -1),
            qvel=jnp.zeros((*lead, self._nv), dtype),
            tyres=init_tyres(*lead, dtype=dtype),
            actuators=actuators,
            vehicle=vehicle,
            trace_w=jnp.broadcast_to(pose[..., None, :], shape),
            finite=jnp.ones(lead, bool),
        )

    @full_float32
    def set_speed(self, state: CarState, speed: jax.Array) -> CarState:
        """Cars (...) as they stand, rolling straight on at speeds (...) [m/s]."""
        yaw, dof = state.trace_w[..., -1, 2], self.index.root_dof
        qvel = jnp.zeros_like(state.qvel)
        qvel = qvel.at[..., dof].set(speed * jnp.cos(yaw))
        qvel = qvel.at[..., dof + 1].set(speed * jnp.sin(yaw))
        spin = (speed / state.vehicle.wheel_radius)[..., None]
        qvel = qvel.at[..., self.index.spin_dof].set(spin)
        actuators = drive.roll_freely(state.actuators, speed)
        return dataclasses.replace(state, qvel=qvel, actuators=actuators)

    @full_float32
    def halt(self, state: CarState, mask: jax.Array, trace_w: jax.Array) -> CarState:
        """Stops cars dead, on the hold; see `Physics.halt`."""
        still = self.init(trace_w[..., -1, :], state.vehicle)
        steer = self.index.steer_qpos
        actuators = dataclasses.replace(
            still.actuators,
            steering=state.actuators.steering,
            lines=state.actuators.lines,
        )
        still = dataclasses.replace(
            still,
            qpos=still.qpos.at[..., steer].set(state.qpos[..., steer]),
            actuators=actuators,
            trace_w=trace_w,
        )
        return where_cars(mask, still, state)

    @full_float32
    def step(self, state: CarState, controls: jax.Array) -> CarState:
        """Advances by one control step; see `Physics.step` and `contain_cars`."""
        with jax.named_scope("physics"):
            vehicle = in_conditions(state.vehicle, self.sim)
            car = started(self.sim, state, controls)
            return contain_cars(state, *self._step(vehicle, car, controls))

    def read(self, state: CarState) -> Motion:
        """Reads the motion out of fresh `qpos` and `qvel`; see `Physics.read`."""
        at = unpack_coordinates(self.index, state.qpos, state.qvel)
        rotation = at.rotation
        velocity_b = [dot(column(rotation, k), at.velocity) for k in range(2)]
        return Motion(
            pose_w=state.trace_w[..., -1, :],
            velocity_b=jnp.stack(velocity_b, -1),
            yaw_rate=at.angular[2],
            steering=state.actuators.steering,
            size=state.vehicle.size,
            trace_w=state.trace_w,
            finite=state.finite,
        )


def started(sim: SimConfig, state: CarState, controls: jax.Array) -> CarDynamics:
    """Cars (...) at the start of a control step, its controls (..., 2) on their way."""
    actuators = state.actuators
    if actuators.lines is not None:
        lines = drive.send(sim, actuators.lines, controls)
        actuators = dataclasses.replace(actuators, lines=lines)
    return CarDynamics(state.qpos, state.qvel, state.tyres, actuators)


def contain_cars(before: CarState, car: CarDynamics, trace_w: jax.Array) -> CarState:
    """Cars (...) after a step with poses `trace_w` (..., k, 3) within it.

    Put back at rest: those with a number that is not finite, or on their side, where no
    tyre model holds.
    """
    # The z axis of the body, turned by the quaternion (w, x, y, z), along the world's.
    up = 1.0 - 2.0 * (jnp.square(car.qpos[..., 4]) + jnp.square(car.qpos[..., 5]))
    moved, still = car._asdict(), {"qvel": jnp.zeros_like(before.qvel)}
    return contain_non_finite(
        before, {**moved, "trace_w": trace_w}, still, up > LEAST_UP
    )
