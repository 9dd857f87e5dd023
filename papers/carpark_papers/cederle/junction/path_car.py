"""Kinematic cars: points that run along their routes and never leave them.

Speed follows its target at limited accelerations; the heading is that of a car with
both axles on the path.
"""

from typing import Any, Protocol

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.geometry import wrap_angle
from carpark_mj.types import Motion
from carpark_papers.cederle.junction.routes import (
    Routes,
    heading_at,
    point_at,
    speed_cap,
)

# SMARTS's passenger car [m]; its wheelbase [est].
SIZE = (3.68, 1.47)
WHEELBASE = 2.3
# m/s^2: what a passenger car gives, [est]; SMARTS's is a Bullet body with torques.
ACCELERATION, BRAKING = 3.0, 7.0
CURVE_BRAKING = 5.0  # m/s^2, with which cars slow down for curves [est]


class Cars(Protocol):
    """A back end: cars (cars,) that follow routes at target speeds."""

    def init(self, routes: Routes, along: jax.Array, speed: jax.Array) -> Any:
        """Cars on their routes.

        Args:
            routes: (cars,).
            along: (cars,) distances of their centres along them [m].
            speed: (cars,) [m/s].
        """
        ...

    def step(self, state: Any, routes: Routes, target_speed: jax.Array) -> Any:
        """Advances by one control step.

        Args:
            state: current state.
            routes: (cars,).
            target_speed: (cars,) [m/s]; curves are taken more slowly.
        """
        ...

    def read(self, state: Any) -> Motion:
        """The motion, as the task reads it."""
        ...


@struct.dataclass
class PathState:
    """Points on routes (cars,).

    Attributes:
        along: [m].
        speed: [m/s].
        yaw_rate: [rad/s].
        steering: [rad].
        trace_w: (cars, k, 3) poses within the last control step.
    """

    along: jax.Array
    speed: jax.Array
    yaw_rate: jax.Array
    steering: jax.Array
    trace_w: jax.Array


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
