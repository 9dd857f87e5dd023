"""A planner as a policy: pure pursuit of the middle line of the goal bay.

A car aims `AHEAD` metres along this line and steers on the arc through that point
(Coulter 1992). It ignores obstacles.
"""

import jax.numpy as jnp

from carpark_mj.geometry import rotate, wrap_angle
from carpark_mj.policy.acting import StatePolicy
from carpark_mj.policy.named import POLICIES

AHEAD = 3.0  # m
SPEED, SLOW = 1.5, 0.3  # m/s, on the way and in the bay
GAIN = 1.0  # pedal per m/s that is missing


def make(env):
    """The policy of an environment whose cars steer and whose goals are fixed."""
    if env.config.goals.dynamic:
        raise ValueError("pure_pursuit needs fixed goals, goals.dynamic = False")
    return StatePolicy(act)


def act(state):
    """Actions (..., agents, 2) in lots (...)."""
    car, pose = state.physics.vehicle, state.motion.pose_w
    bays = state.layout.parked_pose
    goal = jnp.take_along_axis(bays, state.goal[..., None], axis=-2, mode="clip")
    # The bay's axis, pointing as the car does: nose first or tail first.
    turned = jnp.abs(wrap_angle(goal[..., 2] - pose[..., 2])) > jnp.pi / 2
    yaw = goal[..., 2] + jnp.where(turned, jnp.pi, 0.0)
    axis = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
    to_go = jnp.sum((goal[..., :2] - pose[..., :2]) * axis, axis=-1)
    way = jnp.where(to_go < 0.0, -1.0, 1.0)
    aim = goal[..., :2] + (way * AHEAD - to_go)[..., None] * axis
    ahead = rotate(aim - pose[..., :2], -pose[..., 2])
    curvature = 2.0 * ahead[..., 1] / jnp.sum(ahead**2, axis=-1)
    steering = jnp.arctan(curvature * car.wheelbase)
    wanted = way * jnp.where(jnp.abs(to_go) > 1.0, SPEED, SLOW)
    wanted = jnp.where(jnp.abs(to_go) < 0.1, 0.0, wanted)
    pedal = GAIN * (wanted - state.motion.speed)
    action = jnp.stack([steering / car.max_steering, pedal], axis=-1)
    return jnp.clip(action, -1.0, 1.0)


POLICIES.register("pure_pursuit", make)
