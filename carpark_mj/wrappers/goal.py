"""Goal poses that can be relabelled (HER): `carpark_mj/ParkGoal-v0`."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import Layout
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.observations import make_fields
from carpark_mj.physics.base import Physics
from carpark_mj.tasks.goal_pose import (
    FEATURES,
    NUM_FEATURES,
    POSE,
    car_features,
    goal_features,
    pose_norm,
)
from carpark_mj.types import State, TimeStep
from carpark_mj.wrappers.batch import NumpyBatch
from carpark_mj.wrappers.gymnasium_env import (
    ONE_AGENT,
    ParkEnv,
    ParkVectorEnv,
    one_agent,
)
from carpark_mj.wrappers.options import Options, configure, share, vector_space


class GoalParking(ParkingEnv):
    """One agent whose observation ends with its own features and those of its goal.

    The observation is a vector of three parts, see `unpack`: the `fields` that do not
    reveal the goal, and `FEATURES` of the car and of the goal, free of noise.
    """

    def __init__(self, config: EnvConfig, physics: Physics | None = None) -> None:
        """See `ParkingEnv`; refuses settings under which goals cannot be relabelled."""
        super().__init__(config, physics)
        config = self.config
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
        paid = {name for name, weight in term_weights(config).items() if weight}
        if "pose" not in paid or paid - {"pose", "crash"}:
            raise ValueError(
                "goal poses need a reward of the terms pose and crash alone, which can "
                f"be computed for other goals, not of {sorted(paid)}"
            )
        self.fields = tuple(field for field in fields if not field.reveals_goal)
        keep = [not field.reveals_goal for field in fields]
        self._kept = np.flatnonzero(np.repeat(keep, [field.size for field in fields]))

    @property
    def observation_size(self) -> int:
        """Length of the vector."""
        return len(self._kept) + 2 * NUM_FEATURES

    def unpack(self, observation: jax.Array) -> dict[str, jax.Array]:
        """The parts of vectors (..., observation_size) by Gymnasium's names."""
        own = len(self._kept)
        parts = jnp.split(observation, [own, own + NUM_FEATURES], axis=-1)
        names = "observation", "achieved_goal", "desired_goal"
        return dict(zip(names, parts, strict=True))

    def rewards(
        self, achieved: np.ndarray, desired: np.ndarray, crashed: np.ndarray
    ) -> np.ndarray:
        """Rewards (...) of features (..., 6) at a step's end; `crashed` (...) bool."""
        reward = self.config.reward
        parameters = POSE.parameters | reward.parameters("pose")
        # In double precision: sums of one row and of many may round differently.
        norm = pose_norm(np.float64(achieved), np.float64(desired), **parameters)
        paid = -reward.extra["pose"] * norm - reward.crash * crashed
        return paid.astype(np.float32)

    def _begin(
        self, present: Any, given: Any, layout: Layout, key: jax.Array
    ) -> tuple[State, jax.Array]:
        state, seen = super()._begin(present, given, layout, key)
        return state, self._vector(state, seen)

    def _step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        after, timestep = super()._step(state, action)
        vector = self._vector(after, timestep.observation)
        return after, dataclasses.replace(timestep, observation=vector)

    def _vector(self, state: State, observation: jax.Array) -> jax.Array:
        own: Any = observation[:, self._kept]
        parts = own, car_features(state.motion), goal_features(state)
        return jnp.concatenate(parts, axis=-1)


Info = Mapping[str, Any]  # of a step


def goal_config(options: Options) -> EnvConfig:
    """The configuration of one agent from options.

    By default the reward is `pose`; the goal pose and the parked rule end episodes.
    """
    config = one_agent(configure({"reward": "pose", **options}, ONE_AGENT))
    if "rule" in options:
        return config
    rule = f"{config.episode.parked_rule},pose"
    episode = dataclasses.replace(config.episode, parked_rule=rule)
    return dataclasses.replace(config, episode=episode)


class _Goals:
    """The reward as a function of goals, as learners that relabel goals call it."""

    _batch: NumpyBatch
    _config = staticmethod(goal_config)

    def _make(self, options: Options) -> GoalParking:
        return share(GoalParking, self._config(options))

    def _space(self, env: ParkingEnv) -> spaces.Dict:
        assert isinstance(env, GoalParking)
        own, goal = (
            vector_space(env.config, fields) for fields in (env.fields, FEATURES)
        )
        return spaces.Dict(observation=own, achieved_goal=goal, desired_goal=goal)

    def compute_reward(
        self,
        achieved_goal: np.ndarray,
        desired_goal: np.ndarray,
        info: Info | Sequence[Info],
    ) -> np.ndarray:
        """Rewards (...) of features (..., 6), as `step` pays them.

        There is an info of the step, or one for each row; without a key `crashed` there
        is no crash penalty.
        """
        rows = [info] if isinstance(info, Mapping) else info
        crashed = np.array([row.get("crashed", False) for row in rows], np.float32)
        if isinstance(info, Mapping):
            crashed = crashed[0]
        return self._batch.env.rewards(achieved_goal, desired_goal, crashed)


class ParkGoalEnv(_Goals, ParkEnv):
    """One agent drives to a pose; the rest is as in `ParkEnv`.

    - observation: a dictionary of `observation` (fields that do not reveal the goal),
      `achieved_goal` and `desired_goal` (6,): x, y, vx, vy, cos and sin of the heading
      in the world frame, see `carpark_mj.tasks.goal_pose`.
    - reward: `compute_reward(achieved_goal, desired_goal, info)`, by default that of
      `carpark_mj.config.REWARDS["pose"]`.
    - end: terminated when the goal is reached, parked or crashed.
    - info: `is_success` (reached or parked) and `crashed`.
    """

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """See `ParkEnv.step`; the reward is exactly that of `compute_reward`."""
        seen, _, terminated, truncated, info = super().step(action)
        goals = seen["achieved_goal"], seen["desired_goal"]
        reward = float(self.compute_reward(*goals, info))
        return seen, reward, terminated, truncated, info


class ParkGoalVectorEnv(_Goals, ParkVectorEnv):
    """`carpark_mj/ParkGoal-v0` many times; see `ParkVectorEnv` and `ParkGoalEnv`."""
