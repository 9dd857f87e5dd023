"""Parking with poses as goals, so that goals can be relabelled (HER).

Features, reward and success follow highway-env's parking (`parking_env.py`, 1.12):
poses are six numbers, the reward is a weighted p-norm of their difference.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import (
    CheckedConfig,
    require_at_least,
    require_kind,
    require_positive,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import rotate
from carpark_mj.layouts import BayEnd
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.mdp.reset_options import ResetOptions
from carpark_mj.observations import make_fields
from carpark_mj.observations.fields import Field
from carpark_mj.types import Events, Motion, State, TimeStep

POSITION = 100.0  # m, scale of x and y
SPEED = 5.0  # m/s, scale of velocities

FEATURES = (
    Field(
        "position",
        2,
        -4.0,
        4.0,
        f"centre, world frame [{POSITION:g} m]",
        metres=POSITION,
    ),
    Field("velocity", 2, -4.0, 4.0, f"world frame [{SPEED:g} m/s]", speed=SPEED),
    Field("heading", 2, -1.0, 1.0, "cos and sin, world frame"),
)
NUM_FEATURES = sum(field.size for field in FEATURES)


@dataclasses.dataclass(frozen=True)
class PoseReward(CheckedConfig):
    """Pays for being near a pose: - (weights · |achieved - desired|) ^ power.

    Attributes:
        weights: of the features x, y, vx, vy, cos and sin of the heading.
        power: p of the p-norm.
        crash: penalty for crashing, once.
        threshold: the goal is reached where the norm is below it, and nothing crashed.
    """

    weights: tuple[float, ...] = (1.0, 0.3, 0.0, 0.0, 0.02, 0.02)
    power: float = 0.5
    crash: float = 5.0
    threshold: float = 0.12

    def __post_init__(self) -> None:
        super().__post_init__()
        good = len(self.weights) == NUM_FEATURES
        if not (good and all(0.0 <= x < math.inf for x in self.weights)):
            raise ValueError(
                f"weights must be {NUM_FEATURES} numbers of at least 0, not "
                f"{self.weights}"
            )
        require_positive(self, "power", "threshold")
        require_at_least(self, 0.0, "crash")

    def norm(self, achieved: Any, desired: Any) -> Any:
        """Weighted p-norm (...) of the difference of features (..., 6), as given."""
        weights = np.array(self.weights, np.float32)
        return (abs(achieved - desired) @ weights) ** self.power


class GoalParking:
    """One agent, a `ParkingEnv`, and a goal pose.

    An agent's observation is a vector of three parts, see `split`: what it observes but
    for its own goal, its own features, and those of its goal: nose in, at rest.

    Attributes:
        parking: the environment around which this is built.
        pose_reward: reward, and when the goal is reached. So is it where the agent has
            parked by `EpisodeConfig.parked_rule`.
        fields: of the first part.
        goal_fields: of the second and the third part.
    """

    fields: tuple[Field, ...]
    goal_fields = FEATURES

    def __init__(self, parking: ParkingEnv, pose_reward: PoseReward) -> None:
        """Wraps an environment.

        Raises:
            ValueError: not one agent that stays where it has finished, a dynamic goal,
                or observations without a field that reveals the goal.
            TypeError: an argument of another type.
        """
        require_kind("parking", parking, ParkingEnv)
        require_kind("pose_reward", pose_reward, PoseReward)
        config = parking.config
        if config.num_agents != 1 or config.episode.respawn or config.goals.dynamic:
            raise ValueError(
                "goal poses need num_agents = 1, episode.respawn = False and "
                "goals.dynamic = False"
            )
        fields = make_fields(config)
        if not any(field.reveals_goal for field in fields):
            raise ValueError(
                "goal poses need an observation whose fields say what reveals the goal "
                f"(Field.reveals_goal): the encoding {config.observation.encoding!r} "
                "has none"
            )
        self.parking, self.pose_reward = parking, pose_reward
        self.fields = tuple(field for field in fields if not field.reveals_goal)
        keep = [not field.reveals_goal for field in fields]
        self._kept = np.flatnonzero(np.repeat(keep, [field.size for field in fields]))

    @property
    def config(self) -> EnvConfig:
        """Of `parking`."""
        return self.parking.config

    @property
    def num_agents(self) -> int:
        """One."""
        return 1

    @property
    def observation_size(self) -> int:
        """Length of the vector."""
        return self._own_size + 2 * NUM_FEATURES

    @property
    def respawns(self) -> bool:
        """Of `parking`."""
        return self.parking.respawns

    @property
    def action_spec(self) -> ActionSpec:
        """Of `parking`."""
        return self.parking.action_spec

    def split(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """The parts of vectors (..., observation_size) by Gymnasium's names."""
        parts = np.split(vector, [self._own_size, -NUM_FEATURES], axis=-1)
        names = "observation", "achieved_goal", "desired_goal"
        return dict(zip(names, parts, strict=True))

    def reset(
        self, key: jax.Array, options: ResetOptions | None = None
    ) -> tuple[State, jax.Array]:
        """Starts a lot; see `ParkingEnv.reset`."""
        state, observation = self.parking.reset(key, options=options)
        return state, self._vector(state, observation)

    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """Advances the lot; see `ParkingEnv.step`. `parked` includes goals reached."""
        after, timestep = self.parking.step(state, action)
        norm = self.pose_reward.norm(pose_features(timestep.motion), _desired(after))
        near = norm < self.pose_reward.threshold
        events = self.update_events(state.active, after.step, timestep.events, near)
        return dataclasses.replace(after, active=state.active & ~events.done), (
            dataclasses.replace(
                timestep,
                observation=self._vector(after, timestep.observation),
                reward=-norm - self.pose_reward.crash * events.crashed,
                terminated=events.parked | events.crashed,
                truncated=events.timed_out | events.diverged,
                events=events,
            )
        )

    def update_events(
        self, active: jax.Array, step: jax.Array, events: Events, near: jax.Array
    ) -> Events:
        """How episodes stand after a step; all (1,).

        Args:
            active: before the step.
            step: number of steps made.
            events: by `EpisodeConfig`.
            near: whether the norm is below the threshold.
        """
        del step
        reached = active & near & ~events.crashed
        return dataclasses.replace(
            events,
            parked=events.parked | reached,
            timed_out=events.timed_out & ~reached,
            diverged=events.diverged & ~reached,
        )

    def own_part(self, state: State, observation: jax.Array) -> jax.Array:
        """The first part (1, n), of what the agent observes."""
        del state
        return observation[:, self._kept]

    @property
    def _own_size(self) -> int:
        return sum(field.size for field in self.fields)

    def _vector(self, state: State, observation: jax.Array) -> jax.Array:
        own = self.own_part(state, observation)
        parts = own, pose_features(state.motion), _desired(state)
        return jnp.concatenate(parts, axis=-1)


def pose_features(motion: Motion) -> jax.Array:
    """`FEATURES` (..., 6) of cars (...)."""
    yaw = motion.pose_w[..., 2]
    velocity_w = rotate(motion.velocity_b, yaw)
    heading = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
    parts = motion.xy / POSITION, velocity_w / SPEED, heading
    return jnp.concatenate(parts, axis=-1)


def _desired(state: State) -> jax.Array:
    """Features (1, 6) of the goal: in its middle, at rest, nose in if it may be."""
    layout = state.layout
    x, y, yaw = jnp.moveaxis(layout.bay_pose[state.goal], -1, 0)
    zero = jnp.zeros_like(x)
    # A bay's heading is that of a car that has backed in.
    cos, sin = -jnp.cos(yaw), -jnp.sin(yaw)
    if layout.bay_end is not None:
        tail_first = layout.bay_end[state.goal] == BayEnd.TAIL_FIRST
        cos, sin = jnp.where(tail_first, -cos, cos), jnp.where(tail_first, -sin, sin)
    features = [x / POSITION, y / POSITION, zero, zero, cos, sin]
    return jnp.stack(features, axis=-1)
