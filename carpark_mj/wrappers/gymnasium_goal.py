"""One agent and a goal pose for Gymnasium: `carpark_mj/ParkGoal-v0`."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.wrappers.batch import NumpyBatch
from carpark_mj.wrappers.goal import GoalParking
from carpark_mj.wrappers.gymnasium_env import ONE_AGENT, ParkEnv, one_agent
from carpark_mj.wrappers.gymnasium_vector import ParkVectorEnv
from carpark_mj.wrappers.options import Options, configure, share

Info = Mapping[str, Any]


def goal_config(options: Options) -> EnvConfig:
    """The configuration of one agent from options.

    By default the reward is `pose`, and both the goal pose and the parked rule end an
    episode.

    Raises:
        TypeError: an unknown option.
        ValueError: an impossible one.
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

    def compute_reward(
        self,
        achieved_goal: np.ndarray,
        desired_goal: np.ndarray,
        info: Info | Sequence[Info],
    ) -> np.ndarray:
        """Rewards (...) of features (..., 6), as `step` pays them.

        Args:
            achieved_goal: at the end of the step.
            desired_goal: of the same shape.
            info: of the step, or one for each row; without a key `crashed` there is no
                crash penalty.
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
