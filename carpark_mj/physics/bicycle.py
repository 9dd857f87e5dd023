"""The kinematic bicycle: a car whose tyres never slip.

The equations are those of highway-env (E. Leurent, 2018, `vehicle/kinematics.py`, after
P. Polack et al., "The kinematic bicycle model", IV 2017): about the middle between the
axles, with the steering angle d, the slip angle b = atan(tan(d) / 2), the speed v and
the wheelbase L,

    x' = v cos(yaw + b),  y' = v sin(yaw + b),  yaw' = v sin(b) / (L / 2).

highway-env takes the car's length for L and has no lag, see `highway`. Here L is the
wheelbase, and controls act as in `vehicle.drive`, so that a policy drives both cars.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig, SimConfig
from carpark_mj.geometry import move_forward, wrap_angle
from carpark_mj.physics import base
from carpark_mj.precision import full_float32
from carpark_mj.types import Motion
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.vehicle import Vehicle

Carry = tuple[jax.Array, jax.Array, drive.Actuators]  # pose_w, speed, actuators


@dataclasses.dataclass(frozen=True)
class BicycleConfig(PhysicsConfig):
    """Kinematic cars whose tyres never slip."""

    back_end: str = "bicycle"

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> "BicyclePhysics":
        """Builds it; its ground is a plane."""
        return BicyclePhysics(config.sim)


@struct.dataclass
class BicycleState:
    """Physics state of cars; any leading batch shape."""

    pose_w: jax.Array  # (..., 3) pose of the middle between the axles
    speed: jax.Array  # (...) of that point, forwards positive [m/s]
    actuators: drive.Actuators  # state of steering and drive
    vehicle: Vehicle  # parameters
    trace_w: jax.Array  # (..., k, 3) footprint poses within the last control step
    finite: jax.Array  # (...) bool, see `Motion.finite`


def slip_angle(steering: jax.Array) -> jax.Array:
    """Angle [rad] of the motion of the middle between the axles, left positive."""
    return jnp.arctan(jnp.tan(steering) / 2)


def advance(
    pose_w: jax.Array,
    speed: jax.Array,
    steering: jax.Array,
    wheelbase: jax.Array,
    dt: float,
) -> jax.Array:
    """Pose (..., 3) of the middle between the axles after `dt` [s].

    Speed (...) [m/s] and steering (...) [rad] are constant in between; the midpoint
    rule is exact in the heading and of second order in the position.
    """
    slip = slip_angle(steering)
    turned = speed * jnp.sin(slip) / (wheelbase / 2) * dt
    course = pose_w[..., 2] + slip + turned / 2
    direction = jnp.stack([jnp.cos(course), jnp.sin(course)], axis=-1)
    xy = pose_w[..., :2] + (speed * dt)[..., None] * direction
    return jnp.concatenate([xy, wrap_angle(pose_w[..., 2] + turned)[..., None]], -1)


class BicyclePhysics(base.Physics[BicycleState]):
    """The kinematic bicycle behind the `Physics` interface."""

    config = PHYSICS.register("bicycle", BicycleConfig())

    def __init__(self, sim: SimConfig) -> None:
        """Takes the time steps; see `require_plain_ground` for what it refuses."""
        base.require_plain_ground(sim, self.config.back_end)
        self.sim = sim

    @full_float32
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> BicycleState:
        """Cars at rest, wheels straight; see `Physics.init`."""
        pose = jnp.concatenate([pose_w[..., :2], wrap_angle(pose_w[..., 2:])], axis=-1)
        still = jnp.zeros(pose_w.shape[:-1], pose_w.dtype)
        shape = (*still.shape, self.sim.num_traces, 3)
        return BicycleState(
            pose_w=move_forward(pose, -self.ahead(vehicle)),
            speed=still,
            actuators=drive.init_actuators(vehicle),
            vehicle=vehicle,
            trace_w=jnp.broadcast_to(pose[..., None, :], shape),
            finite=jnp.ones(still.shape, bool),
        )

    def set_speed(self, state: BicycleState, speed: jax.Array) -> BicycleState:
        """Cars (...) as they stand, rolling straight on at speeds (...) [m/s]."""
        return dataclasses.replace(
            state,
            speed=speed.astype(state.speed.dtype),
            actuators=drive.roll_freely(state.actuators, speed),
        )

    def halt(
        self, state: BicycleState, mask: jax.Array, trace_w: jax.Array
    ) -> BicycleState:
        """Stops cars dead, on the hold; see `Physics.halt`."""
        still = self.init(trace_w[..., -1, :], state.vehicle)
        actuators = dataclasses.replace(
            still.actuators, steering=state.actuators.steering
        )
        still = dataclasses.replace(still, actuators=actuators, trace_w=trace_w)
        return base.where_cars(mask, still, state)

    @full_float32
    def step(self, state: BicycleState, controls: jax.Array) -> BicycleState:
        """Advances by one control step; see `Physics.step`.

        A car with a non-finite number is put back, at rest, and flagged.
        """
        vehicle = state.vehicle
        with jax.named_scope("physics"):
            carry, trace_w = base.run_substeps(
                self.sim,
                lambda carry: self.substep(vehicle, controls, carry),
                (state.pose_w, state.speed, state.actuators),
                lambda carry: move_forward(carry[0], self.ahead(vehicle)),
            )
            pose_w, speed, actuators = carry
            moved = {"pose_w": pose_w, "speed": speed, "actuators": actuators}
            moved["trace_w"] = jnp.moveaxis(trace_w, 0, -2)
            still = {"speed": jnp.zeros_like(state.speed)}
            return base.contain_non_finite(state, moved, still)

    def read(self, state: BicycleState) -> Motion:
        """The motion of the cars; see `Physics.read`."""
        slip = slip_angle(state.actuators.steering + state.vehicle.steering_offset)
        # The rear axle follows the middle between the axles along the car's axis.
        rear = state.speed * jnp.cos(slip)
        return Motion(
            pose_w=state.trace_w[..., -1, :],
            velocity_b=jnp.stack([rear, jnp.zeros_like(rear)], axis=-1),
            yaw_rate=state.speed * jnp.sin(slip) / (state.vehicle.wheelbase / 2),
            steering=state.actuators.steering,
            size=state.vehicle.size,
            trace_w=state.trace_w,
            finite=state.finite,
        )

    def ahead(self, vehicle: Vehicle) -> jax.Array:
        """Footprint's centre ahead of the middle between the axles (...) [m]."""
        return vehicle.centre_offset - vehicle.wheelbase / 2

    def substep(self, vehicle: Vehicle, controls: jax.Array, carry: Carry) -> Carry:
        """Cars (...) after a substep of `SimConfig.sim_dt`; controls (..., 2)."""
        dt, (steer, pedal) = self.sim.sim_dt, jnp.unstack(controls, axis=-1)
        pose, speed, actuators = carry
        steering = drive.steer_towards(vehicle, actuators.steering, steer, dt)
        angle = steering + vehicle.steering_offset
        rear = speed * jnp.cos(slip_angle(angle))
        actuators, brake = drive.press_pedal(vehicle, actuators, pedal, rear, rear, dt)
        lever = vehicle.mass * vehicle.wheel_radius
        driven = speed + actuators.drive / lever * dt
        braked = jnp.maximum(jnp.abs(driven) - brake / lever * dt, 0.0)  # at most to 0
        faster = jnp.sign(driven) * braked
        pose = advance(pose, (speed + faster) / 2, angle, vehicle.wheelbase, dt)
        return pose, faster, dataclasses.replace(actuators, steering=steering)
