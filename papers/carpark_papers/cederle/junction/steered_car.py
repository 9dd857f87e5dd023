"""Cars that steer along their routes: the car physics under lane following."""

import dataclasses
from typing import Any, Protocol

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.types import Motion
from carpark_mj.vehicle import Vehicle, VehicleParameters, make_vehicle
from carpark_papers.cederle.junction import follow
from carpark_papers.cederle.junction.path_car import (
    ACCELERATION,
    BRAKING,
    CURVE_BRAKING,
)
from carpark_papers.cederle.junction.routes import (
    Routes,
    heading_at,
    point_at,
    project,
    speed_cap,
)

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
    """Cars (cars,) and what their drivers remember.

    Attributes:
        physics: of the back end.
        integral: (cars,) of the error in speed [m].
    """

    physics: Any
    integral: jax.Array


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
        pedal, integral = follow.control_speed(
            speed, jnp.minimum(target_speed, cap), state.integral, vehicle, dt
        )
        controls = jnp.stack([follow.steer(routes, motion, vehicle), pedal], axis=-1)
        return SteeredState(self._physics.step(state.physics, controls), integral)

    def read(self, state: SteeredState) -> Motion:
        """See `Cars.read`."""
        return self._physics.read(state.physics)
