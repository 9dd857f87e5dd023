"""The cars of the junction: on their routes, or steered along them.

Steering is pure pursuit (R. C. Coulter, "Implementation of the Pure Pursuit Path
Tracking Algorithm", CMU-RI-TR-92-01, 1992): the rear axle is led on the circle through
a point of the path some way ahead. The look-ahead grows with the speed (as in J. M.
Snider, CMU-RI-TR-09-08, 2009, section 2.2). The pedal is a proportional-integral
controller of the speed, whose integral stands still while the pedal is at an end.

Speed follows its target at limited accelerations; the heading is that of a car with
both axles on the path.
"""

import dataclasses
from typing import Any, Protocol

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.geometry import move_forward, norm, rotate, wrap_angle
from carpark_mj.types import Motion
from carpark_mj.vehicle import VehicleParameters, make_vehicle
from carpark_mj.vehicle.drive import HOLD_SPEED
from carpark_mj.vehicle.vehicle import Vehicle
from carpark_papers.cederle.junction.roads import (
    Routes,
    heading_at,
    point_at,
    project,
    speed_cap,
)

# Tuned on the six routes of the junction with the preset `city`.
LOOKAHEAD, LOOKAHEAD_TIME = 2.0, 0.3  # m, s
GAIN, INTEGRAL_GAIN = 3.0, 0.6  # 1/s, 1/s^2


def steer(routes: Routes, motion: Motion, vehicle: Vehicle) -> jax.Array:
    """Steering (cars,) in [-1, 1] that leads cars (cars,) along their routes."""
    yaw = motion.pose_w[..., 2]
    rear = move_forward(motion.pose_w, -vehicle.centre_offset)[..., :2]
    along, _ = project(routes, rear)
    ahead = LOOKAHEAD + LOOKAHEAD_TIME * jnp.maximum(motion.speed, 0.0)
    target = rotate(point_at(routes, along + ahead) - rear, -yaw)
    reach = norm(target)
    curvature = 2.0 * target[..., 1] / (reach * reach)
    angle = jnp.arctan(vehicle.wheelbase * curvature)
    return jnp.clip(angle / vehicle.max_steering, -1.0, 1.0)


def control_speed(
    speed: jax.Array,
    target_speed: jax.Array,
    integral: jax.Array,
    vehicle: Vehicle,
    dt: float,
) -> tuple[jax.Array, jax.Array]:
    """Pedals (cars,) in [-1, 1] that bring cars to target speeds, at least 0 [m/s].

    `integral` (cars,) is that of the speed's error so far [m]; its value after the
    control step of `dt` [s] is returned, too.
    """
    error = target_speed - speed
    summed = integral + error * dt
    wanted = GAIN * error + INTEGRAL_GAIN * summed
    most = jnp.where(wanted < 0.0, vehicle.max_deceleration, vehicle.max_acceleration)
    pedal = jnp.clip(wanted / most, -1.0, 1.0)
    summed = jnp.where(jnp.abs(wanted) > most, integral, summed)
    # No pedal holds a car that stands; against its motion it would reverse.
    holds = (target_speed < HOLD_SPEED) & (speed < HOLD_SPEED)
    return jnp.where(holds, 0.0, pedal), jnp.where(holds, 0.0, summed)


# SMARTS's passenger car [m]; its wheelbase [est].
SIZE = (3.68, 1.47)
WHEELBASE = 2.3
# m/s^2: what a passenger car gives, [est]; SMARTS's is a Bullet body with torques.
ACCELERATION, BRAKING = 3.0, 7.0
CURVE_BRAKING = 5.0  # m/s^2, with which cars slow down for curves [est]


class Cars(Protocol):
    """A back end: cars (cars,) that follow routes at target speeds."""

    def init(self, routes: Routes, along: jax.Array, speed: jax.Array) -> Any:
        """Cars at distances (cars,) [m] along their routes, at speeds (cars,) [m/s]."""
        ...

    def step(self, state: Any, routes: Routes, target_speed: jax.Array) -> Any:
        """Advances by one control step; curves are taken more slowly."""
        ...

    def read(self, state: Any) -> Motion:
        """The motion, as the task reads it."""
        ...


@struct.dataclass
class PathState:
    """Points on routes (cars,)."""

    along: jax.Array  # [m]
    speed: jax.Array  # [m/s]
    yaw_rate: jax.Array  # [rad/s]
    steering: jax.Array  # [rad]
    trace_w: jax.Array  # (cars, k, 3) poses within the last control step


class PathCars:
    """Points on paths behind the `Cars` interface."""

    def __init__(self, sim: SimConfig) -> None:
        """Takes the control step and the time between collision tests."""
        self._dt = sim.ctrl_dt / sim.num_traces
        self._num_traces = sim.num_traces

    def init(self, routes: Routes, along: jax.Array, speed: jax.Array) -> PathState:
        """See `Cars.init`."""
        pose = _pose(routes, along)
        still = jnp.zeros_like(along)
        trace = jnp.broadcast_to(pose[:, None], (*still.shape, self._num_traces, 3))
        return PathState(along, speed, still, _steering(routes, along), trace)

    def step(
        self, state: PathState, routes: Routes, target_speed: jax.Array
    ) -> PathState:
        """See `Cars.step`."""
        dt, along, speed = self._dt, state.along, state.speed
        poses = [state.trace_w[:, -1]]
        for _ in range(self._num_traces):
            cap = speed_cap(routes, along + speed * dt, CURVE_BRAKING)
            wanted = (jnp.minimum(target_speed, cap) - speed) / dt
            faster = speed + jnp.clip(wanted, -BRAKING, ACCELERATION) * dt
            along, speed = along + (speed + faster) / 2 * dt, faster
            poses.append(_pose(routes, along))
        turned = wrap_angle(poses[-1][:, 2] - poses[-2][:, 2])
        steering = _steering(routes, along)
        return PathState(
            along, speed, turned / dt, steering, jnp.stack(poses[1:], axis=1)
        )

    def read(self, state: PathState) -> Motion:
        """See `Cars.read`."""
        still = jnp.zeros_like(state.speed)
        return Motion(
            pose_w=state.trace_w[:, -1],
            velocity_b=jnp.stack([state.speed, still], axis=-1),
            yaw_rate=state.yaw_rate,
            steering=state.steering,
            size=jnp.broadcast_to(jnp.array(SIZE), (*still.shape, 2)),
            trace_w=state.trace_w,
            finite=jnp.ones(still.shape, bool),
        )


def _pose(routes: Routes, along: jax.Array) -> jax.Array:
    """Poses (cars, 3) at distances (cars,) along the routes."""
    yaw = heading_at(routes, along, jnp.full_like(along, WHEELBASE))
    return jnp.concatenate([point_at(routes, along), yaw[:, None]], axis=-1)


def _steering(routes: Routes, along: jax.Array) -> jax.Array:
    """Angles (cars,) [rad] between the ways of the front and the rear axle."""
    half = jnp.full_like(along, WHEELBASE / 2)
    front = heading_at(routes, along + half, half)
    return wrap_angle(front - heading_at(routes, along - half, half))


# m/s; the speed limiter acts within 2.5 m/s below it, and the fastest target is 15.
MAX_SPEED = 18.0
# rad/s of the road wheels: a driver who turns off quickly, 700 deg/s at the hand wheel
# over a ratio of 15, [est]. At the car park's 0.42 the right turn cannot be followed.
STEERING_RATE = 0.8


class RoadPhysics(Protocol):
    """A back end of `carpark_mj.physics` that can set cars moving.

    Attributes:
        sim: its time steps.
    """

    sim: SimConfig

    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> Any:
        """Cars at rest; see `carpark_mj.physics.base.Physics`."""
        ...

    def set_speed(self, state: Any, speed: jax.Array) -> Any:
        """Cars (...) as they stand, rolling straight on at speeds (...) [m/s]."""
        ...

    def step(self, state: Any, controls: jax.Array) -> Any:
        """Advances by one control step of steer and pedal (..., 2)."""
        ...

    def read(self, state: Any) -> Motion:
        """What the cars do."""
        ...


@struct.dataclass
class SteeredState:
    """Cars (cars,) and what their drivers remember."""

    physics: Any  # of the back end
    integral: jax.Array  # (cars,) of the error in speed [m]


def road_car(params: VehicleParameters) -> VehicleParameters:
    """A car of the car park as it drives on a road: faster, and brakes harder."""
    return dataclasses.replace(
        params,
        max_speed=MAX_SPEED,
        steering_rate=STEERING_RATE,
        max_acceleration=ACCELERATION,
        max_deceleration=BRAKING,
    )


class SteeredCars:
    """Physical cars behind the `Cars` interface."""

    def __init__(self, physics: RoadPhysics, params: VehicleParameters) -> None:
        """Takes the physics and a car of the car park."""
        self.params = road_car(params)
        self._physics = physics
        self._vehicle = make_vehicle(self.params)

    def init(self, routes: Routes, along: jax.Array, speed: jax.Array) -> SteeredState:
        """See `Cars.init`."""
        vehicle: Vehicle = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (*along.shape, *x.shape)), self._vehicle
        )
        yaw = heading_at(routes, along, vehicle.wheelbase)
        pose = jnp.concatenate([point_at(routes, along), yaw[:, None]], axis=-1)
        physics = self._physics
        state = physics.set_speed(physics.init(pose, vehicle), speed)
        return SteeredState(state, jnp.zeros_like(along))

    def step(
        self, state: SteeredState, routes: Routes, target_speed: jax.Array
    ) -> SteeredState:
        """See `Cars.step`."""
        motion, vehicle = self.read(state), state.physics.vehicle
        dt, speed = self._physics.sim.ctrl_dt, motion.speed
        along = project(routes, motion.xy)[0]
        cap = speed_cap(routes, along + speed * dt, CURVE_BRAKING)
        pedal, integral = control_speed(
            speed, jnp.minimum(target_speed, cap), state.integral, vehicle, dt
        )
        controls = jnp.stack([steer(routes, motion, vehicle), pedal], axis=-1)
        return SteeredState(self._physics.step(state.physics, controls), integral)

    def read(self, state: SteeredState) -> Motion:
        """See `Cars.read`."""
        return self._physics.read(state.physics)
