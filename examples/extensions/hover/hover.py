"""A physics back end: craft that hover, slide sideways and turn on the spot."""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import PHYSICS, PhysicsConfig
from carpark_mj.geometry import rotate, wrap_angle
from carpark_mj.physics.base import Physics, require_plain_ground
from carpark_mj.types import Motion
from carpark_mj.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class HoverConfig(PhysicsConfig):
    """Craft whose controls are shares of their speeds: ahead, to the left, turning.

    Attributes:
        speed: highest speed ahead and to the left [m/s].
        turn_rate: highest yaw rate [rad/s].
        lag: time constant with which speeds follow the controls [s].
        back_end: fixed.
    """

    speed: float = 2.0
    turn_rate: float = 0.8
    lag: float = 0.3
    back_end: str = "hover"
    continuous = 3
    steers = False  # so the two traits below are what a car has in their place
    actuated = False
    randomized = False

    def make(self, config, layout, vehicle):
        """Builds it; one back end serves all lots."""
        return HoverPhysics(self, config.sim)

    def turn(self, before, after, ctrl_dt):
        """Change of heading [rad]."""
        return abs(after.yaw_rate) * ctrl_dt

    def largest_turn(self, vehicle, ctrl_dt):
        """The most that `turn` can be [rad]."""
        return self.turn_rate * ctrl_dt

    def top_speed(self, vehicle, ctrl_dt):
        """That of the craft, not of the car whose size it has [m/s]."""
        return self.speed


@struct.dataclass
class HoverState:
    """Craft (...); the last of the poses `trace_w` (..., k, 3) is the present one.

    `velocity` (..., 3) is ahead, to the left [m/s] and turning [rad/s].
    """

    trace_w: jax.Array
    velocity: jax.Array
    vehicle: Vehicle


class HoverPhysics(Physics[HoverState]):
    """Velocities follow the controls as first-order lags."""

    def __init__(self, config, sim):
        """Takes the settings of the craft and the time steps."""
        require_plain_ground(sim, config.back_end)
        self.config, self.sim = config, sim

    def init(self, pose_w, vehicle):
        """Craft at rest."""
        shape = (*pose_w.shape[:-1], self.sim.num_traces, 3)
        trace_w = jnp.broadcast_to(pose_w[..., None, :], shape)
        return HoverState(trace_w, jnp.zeros_like(pose_w), vehicle)

    def step(self, state, controls):
        """Advances by one control step; `controls` (..., 3)."""
        config, dt = self.config, self.sim.ctrl_dt / self.sim.num_traces
        most = jnp.array([config.speed, config.speed, config.turn_rate])
        wanted, left = controls * most, jnp.exp(-dt / config.lag)

        def advance(carry, _):
            pose, velocity = carry
            missing = velocity - wanted
            moved = wanted * dt + missing * config.lag * (1.0 - left)
            yaw, turned = pose[..., 2], moved[..., 2]
            xy = pose[..., :2] + rotate(moved[..., :2], yaw + turned / 2)
            pose = jnp.concatenate([xy, wrap_angle(yaw + turned)[..., None]], axis=-1)
            return (pose, wanted + missing * left), pose

        start = state.trace_w[..., -1, :], state.velocity
        (_, velocity), trace = jax.lax.scan(advance, start, length=self.sim.num_traces)
        return HoverState(jnp.moveaxis(trace, 0, -2), velocity, state.vehicle)

    def read(self, state):
        """What the task may know."""
        still = jnp.zeros(state.velocity.shape[:-1])
        return Motion(
            pose_w=state.trace_w[..., -1, :],
            velocity_b=state.velocity[..., :2],
            yaw_rate=state.velocity[..., 2],
            steering=still,
            size=state.vehicle.size,
            trace_w=state.trace_w,
            finite=jnp.isfinite(state.velocity).all(axis=-1),
        )


PHYSICS.register("hover", HoverConfig())
