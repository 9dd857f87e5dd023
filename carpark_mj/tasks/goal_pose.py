"""Parking as reaching a pose: the reward term and the parked rule `pose`.

Features, reward and success follow highway-env's parking (`parking_env.py`, 1.12):
poses are six numbers, the reward is a weighted p-norm of their difference.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import (
    PARKED_RULES,
    REWARD_TERMS,
    REWARDS,
    EnvConfig,
    ParkedRule,
    RewardConfig,
    RewardTerm,
)
from carpark_mj.geometry import rotate
from carpark_mj.layouts import BayEnd
from carpark_mj.observations.fields import Field
from carpark_mj.types import Motion, State, Transition

POSITION = 100.0  # m, scale of x and y
SPEED = 5.0  # m/s, scale of velocities

_CENTRE = f"centre, world frame [{POSITION:g} m]"
FEATURES = (
    Field("position", 2, -4.0, 4.0, _CENTRE, metres=POSITION),
    Field("velocity", 2, -4.0, 4.0, f"world frame [{SPEED:g} m/s]", speed=SPEED),
    Field("heading", 2, -1.0, 1.0, "cos and sin, world frame"),
)
NUM_FEATURES = sum(field.size for field in FEATURES)


def car_features(motion: Motion) -> jax.Array:
    """`FEATURES` (..., 6) of cars (...)."""
    yaw = motion.pose_w[..., 2]
    velocity_w = rotate(motion.velocity_b, yaw)
    heading = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
    parts = motion.xy / POSITION, velocity_w / SPEED, heading
    return jnp.concatenate(parts, axis=-1)


def bay_features(pose: jax.Array, end: jax.Array | None) -> jax.Array:
    """`FEATURES` (..., 6) of cars in the middle of bays, at rest, nose in if allowed.

    Bays have poses (..., 3) and ends (...) int32, `BayEnd`; None = either.
    """
    x, y, yaw = jnp.moveaxis(pose, -1, 0)
    zero = jnp.zeros_like(x)
    # A bay's heading is that of a car that has backed in.
    cos, sin = -jnp.cos(yaw), -jnp.sin(yaw)
    if end is not None:
        tail_first = end == BayEnd.TAIL_FIRST
        cos, sin = jnp.where(tail_first, -cos, cos), jnp.where(tail_first, -sin, sin)
    features = [x / POSITION, y / POSITION, zero, zero, cos, sin]
    return jnp.stack(features, axis=-1)


def goal_features(state: State) -> jax.Array:
    """`FEATURES` (num_agents, 6) of the agents' goals."""
    layout, goal = state.layout, state.goal
    end = None if layout.bay_end is None else layout.bay_end[goal]
    return bay_features(layout.bay_pose[goal], end)


def pose_norm(
    achieved: Any,
    desired: Any,
    x: float,
    y: float,
    speed: float,
    heading: float,
    power: float,
) -> Any:
    """Weighted p-norm (...) of the difference of features (..., 6).

    The weights, `speed` of both velocities and `heading` of cosine and sine, and the
    `power` of the norm are parameters of the reward term `pose`.
    """
    weights = np.array([x, y, speed, speed, heading, heading], np.float32)
    return (abs(achieved - desired) @ weights) ** power


def _pose(
    config: EnvConfig,
    transition: Transition,
    x: float = 1.0,
    y: float = 0.3,
    speed: float = 0.0,
    heading: float = 0.02,
    power: float = 0.5,
) -> jax.Array:
    """Weighted p-norm of the difference between the own pose and the goal's."""
    del config
    after = transition.after
    there, goal = car_features(after.motion), goal_features(after)
    return pose_norm(there, goal, x, y, speed, heading, power)


def near(threshold: float) -> Callable[..., jax.Array]:
    """A `ParkedRule.test`: the norm of the default weights is below a number."""

    def test(
        motion: Motion, pose: jax.Array, size: jax.Array, end: jax.Array | None
    ) -> jax.Array:
        del size
        there, goal = car_features(motion), bay_features(pose, end)
        return pose_norm(there, goal, **POSE.parameters) < threshold

    return test


POSE = REWARD_TERMS.register(
    "pose", RewardTerm(_pose, sign=-1, fixed=("x", "y", "speed", "heading", "power"))
)
_NONE = dict.fromkeys(("park", "time", "progress", "alignment", "closeness"), 0.0)
REWARDS.register("pose", RewardConfig(**_NONE, crash=5.0, extra={"pose": 1.0}))
PARKED_RULES.register("pose", ParkedRule(test=near(0.12)))
