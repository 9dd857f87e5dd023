"""The back end `highway`: the kinematic bicycle as highway-env's car integrates it.

The equations are those of `bicycle`, but the axles stand at the bumpers, steering and
acceleration are those asked for, forwards and backwards alike, and a substep is one of
explicit Euler: everything moves on with the speed and heading at its start. Beyond a
speed limit the car slows down by as many m/s^2 as it is too fast in m/s.

It uses the footprint, `max_steering`, `max_acceleration` and the speed limits of a
car's parameters; the preset `highway` has highway-env's. Its `sim_dt` is 1 / 15 s.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig
from carpark_mj.geometry import wrap_angle
from carpark_mj.physics.bicycle import BicyclePhysics, BicycleState, Carry, slip_angle
from carpark_mj.types import Motion
from carpark_mj.vehicle.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class HighwayConfig(PhysicsConfig):
    """highway-env's car, which obeys at once and has a road's speed limits."""

    back_end: str = "highway"
    actuated = False
    randomized = False
    keeps_ranges = False

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> Any:
        """Builds it; it has no ground but a plane."""
        del layout, vehicle
        return HighwayPhysics(config.sim)

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> Any:
        """From lock to lock."""
        del ctrl_dt
        return 2.0 * vehicle.max_steering


PHYSICS.register("highway", HighwayConfig())


class HighwayPhysics(BicyclePhysics):
    """highway-env's car behind the `Physics` interface."""

    config = PHYSICS["highway"]

    def read(self, state: BicycleState) -> Motion:
        """The motion; velocities leave the slip angle out, as in highway-env."""
        speed, vehicle = state.speed, state.vehicle
        return dataclasses.replace(
            super().read(state),
            velocity_b=jnp.stack([speed, jnp.zeros_like(speed)], axis=-1),
            yaw_rate=_yaw_rate(vehicle, speed, state.actuators.steering),
        )

    def ahead(self, vehicle: Vehicle) -> jax.Array:
        """None: the footprint's centre is the middle between the axles."""
        return jnp.zeros_like(vehicle.wheelbase)

    def substep(self, vehicle: Vehicle, controls: jax.Array, carry: Carry) -> Carry:
        """One car after a substep; see `BicyclePhysics.substep`."""
        dt = self.sim.sim_dt
        pose, speed, actuators = carry
        steering = controls[0] * vehicle.max_steering
        course = pose[2] + slip_angle(steering)
        way = speed * jnp.stack([jnp.cos(course), jnp.sin(course)])
        yaw = wrap_angle(pose[2] + _yaw_rate(vehicle, speed, steering) * dt)
        pose = jnp.concatenate([pose[:2] + way * dt, yaw[None]])
        wanted = controls[1] * vehicle.max_acceleration
        headroom = vehicle.max_speed - speed
        back = -vehicle.max_reverse_speed - speed
        wanted = jnp.where(headroom < 0.0, jnp.minimum(wanted, headroom), wanted)
        wanted = jnp.where(back > 0.0, jnp.maximum(wanted, back), wanted)
        actuators = dataclasses.replace(actuators, steering=steering)
        return pose, speed + wanted * dt, actuators


def _yaw_rate(vehicle: Vehicle, speed: jax.Array, steering: jax.Array) -> jax.Array:
    """Yaw rates (...) [rad/s]."""
    return speed * jnp.sin(slip_angle(steering)) / (vehicle.size[..., 0] / 2)
