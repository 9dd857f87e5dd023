"""Sliding cars: a stand-in back end for hand-worked steps, and lots of them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config import PHYSICS, EnvConfig, EpisodeConfig, RayConfig, RingConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation
from carpark_mj.physics.base import Physics
from carpark_mj.types import Motion
from carpark_mj.vehicle import Vehicle

MAX_STEPS = 10
# Agents 0, 1 and 2 stand here by default, 5 m apart, away from bays and walls.
APART = np.array([[-5.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
# Poses alone: rings and rays take long to compile.
POSES = ContinuousObservation(rings=RingConfig(), rays=RayConfig())
HALT = np.zeros((3, 2), np.float32)


@functools.cache
def sliding(config):
    """An environment on sliding cars with its compiled functions."""
    env = ParkingEnv(config, SlidePhysics())
    return env, jax.jit(env.reset), jax.jit(env.step)


def slide(respawn=True, rule="strict"):
    episode = EpisodeConfig(parked_rule=rule, max_steps=MAX_STEPS, respawn=respawn)
    return sliding(EnvConfig(num_agents=3, num_parked_cars=5, episode=episode))


def start(respawn=True, pose=APART, seed=0):
    """One lot with its agents standing at given poses."""
    env, reset, step = slide(respawn)
    state, _ = reset(jax.random.key(seed))
    return env, step, placed(env, state, pose)


def in_goal(env, state, agent):
    """The state with one agent standing in its goal bay, parked."""
    pose = np.array(APART, np.float32)
    pose[agent] = state.layout.bay_pose[state.goal[agent]]
    return placed(env, state, pose)


@struct.dataclass
class SlideState:
    pose_w: jax.Array
    speed: jax.Array
    steering: jax.Array
    trace_w: jax.Array
    finite: jax.Array
    vehicle: Vehicle


class SlidePhysics(Physics[SlideState]):
    """A stand-in back end for hand-worked steps: turn on the spot, then slide ahead.

    `controls` (1, 1) turns 0.2 rad and slides 0.5 m in a step of 0.2 s; a car whose
    speed is NaN diverges. To the task they are cars like any other.
    """

    config = PHYSICS["mjx"]

    def init(self, pose_w, vehicle):
        zero = jnp.zeros(pose_w.shape[:-1], jnp.float32)
        return SlideState(
            pose_w=pose_w,
            speed=zero,
            steering=zero,
            trace_w=jnp.repeat(pose_w[..., None, :], 4, axis=-2),
            finite=jnp.ones(zero.shape, bool),
            vehicle=vehicle,
        )

    def step(self, state, controls):
        finite = jnp.isfinite(state.speed)
        controls = jnp.where(finite[..., None], controls, 0.0)
        yaw = state.pose_w[..., 2] + 0.2 * controls[..., 0]
        ahead = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
        share = jnp.arange(1, 5, dtype=jnp.float32) / 4
        way = 0.5 * controls[..., 1, None] * share
        xy = state.pose_w[..., None, :2] + way[..., None] * ahead[..., None, :]
        turned = jnp.broadcast_to(yaw[..., None, None], (*xy.shape[:-1], 1))
        trace = jnp.concatenate([xy, turned], axis=-1)
        return state.replace(
            pose_w=trace[..., -1, :],
            speed=2.5 * controls[..., 1],
            steering=0.1 * controls[..., 0],
            trace_w=trace,
            finite=finite,
        )

    def read(self, state):
        return Motion(
            pose_w=state.pose_w,
            velocity_b=jnp.stack([state.speed, jnp.zeros_like(state.speed)], axis=-1),
            yaw_rate=jnp.zeros_like(state.speed),
            steering=state.steering,
            size=state.vehicle.size,
            trace_w=state.trace_w,
            finite=state.finite,
        )


def placed(env, state, pose):
    """The state with its cars standing at the given poses (lots, agents, 3)."""
    return _placed(env, state, np.asarray(pose, np.float32))


@functools.partial(jax.jit, static_argnums=0)
def _placed(env, state, pose):
    physics = env.physics.init(pose, state.physics.vehicle)
    return state.replace(physics=physics, motion=env.physics.read(physics))
