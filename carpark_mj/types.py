"""State types shared by the physics and the task. All are pytrees of float32 arrays.

The suffix `_w` marks the world frame, `_b` the body frame of the car (x forward,
y left). Units are SI and radians.
"""

import jax
from flax import struct


@struct.dataclass
class Motion:
    """What the task may know of the cars' motion; any leading batch shape `(...)`.

    Attributes:
        pose_w: (..., 3) pose of the footprint's centre: x [m], y [m], yaw [rad] in
            [-pi, pi).
        velocity_b: (..., 2) velocity of the rear-axle centre, forward and left [m/s].
        yaw_rate: (...) [rad/s], counter-clockwise positive.
        steering: (...) commanded road-wheel angle of the bicycle model [rad], left
            positive.
        size: (..., 2) length and width of the footprint [m].
        trace_w: (..., k, 3) poses at k equally spaced instants of the last control
            step, at most `SimConfig.trace_dt` apart; the last equals `pose_w`.
        finite: (...) bool; False where the physics produced a non-finite number in
            the last step and the car was put back to its last finite state.
        touched: (..., 3) bool, whether the car touched another agent, a parked car, a
            wall at any substep of the last step; None where the physics has no
            contacts and the task finds them by box tests.
    """

    pose_w: jax.Array
    velocity_b: jax.Array
    yaw_rate: jax.Array
    steering: jax.Array
    size: jax.Array
    trace_w: jax.Array
    finite: jax.Array
    touched: jax.Array | None = None

    @property
    def speed(self) -> jax.Array:
        """(...) signed speed along the car's axis [m/s]."""
        return self.velocity_b[..., 0]


@struct.dataclass
class Events:
    """How each agent's episode stands after a step; all (num_agents,) bool.

    `parked`, `crashed`, `timed_out` and `diverged` exclude each other; together they
    are `done`. The `hit_*` flags say what a crashed agent touched (several can hold).
    """

    parked: jax.Array
    crashed: jax.Array
    timed_out: jax.Array
    diverged: jax.Array
    hit_agent: jax.Array
    hit_parked_car: jax.Array
    hit_wall: jax.Array

    @property
    def done(self) -> jax.Array:
        """(num_agents,) the agent's episode has ended."""
        return self.parked | self.crashed | self.timed_out | self.diverged
