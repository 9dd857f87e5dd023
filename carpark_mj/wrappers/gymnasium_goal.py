"""One agent and a goal pose as a Gymnasium environment: `carpark_mj/ParkGoal-v0`."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, Unpack

import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_kind
from carpark_mj.env import ParkingEnv
from carpark_mj.wrappers.batch import LotEnv
from carpark_mj.wrappers.goal import GoalParking, PoseReward
from carpark_mj.wrappers.gymnasium_env import ONE_AGENT, ParkEnv, one_agent
from carpark_mj.wrappers.options import Options, configure, shared_env

# The terms of `RewardConfig` are not paid here.
GOAL_OPTIONS = tuple(name for name in ONE_AGENT if name != "reward")
Info = Mapping[str, Any]
GoalEnv = TypeVar("GoalEnv", bound=GoalParking)


class PoseRewardMixin:
    """The reward as a function of goals, as learners that relabel goals call it."""

    default_reward = PoseReward()
    pose_reward: PoseReward

    def _take(self, pose_reward: PoseReward | None) -> None:
        """Sets the reward; None = the default."""
        require_kind("pose_reward", pose_reward, PoseReward | None)
        self.pose_reward = pose_reward or self.default_reward

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
            info: of the step, or one for each row; where it says nothing about
                `crashed`, nothing is deducted.
        """
        rows = [info] if isinstance(info, Mapping) else info
        crashed = np.array([row.get("crashed", False) for row in rows], np.float32)
        if isinstance(info, Mapping):
            crashed = crashed[0]
        norm = self.pose_reward.norm(achieved_goal, desired_goal)
        return -norm - self.pose_reward.crash * crashed


class ParkGoalEnv(PoseRewardMixin, ParkEnv):
    """One agent drives to a pose; as `ParkEnv`, but for these.

    - observation: a dictionary of `observation` (what the agent observes but for its
      goal), `achieved_goal` and `desired_goal` (6,): x, y, vx, vy, cos and sin of the
      heading in the world frame, see `carpark_mj.wrappers.goal`.
    - reward: `compute_reward(achieved_goal, desired_goal, info)`, see `PoseReward`.
    - end: terminated when the goal is reached, parked or crashed.
    - info: `is_success` (reached or parked) and `crashed`.
    """

    def __init__(
        self,
        render_mode: str | None = None,
        camera: str = "topdown",
        pose_reward: PoseReward | None = None,
        **options: Unpack[Options],
    ) -> None:
        """As of `ParkEnv`.

        Args:
            render_mode: None, `human` or `rgb_array`.
            camera: see `ParkEnv`.
            pose_reward: reward, and when the goal is reached.
            **options: see `Options`, without `agents` and `reward`.
        """
        self._take(pose_reward)
        super().__init__(render_mode, camera, **options)

    def _make(self, options: Options) -> LotEnv:
        config = one_agent(configure(options, GOAL_OPTIONS))
        return shared_goal_env(config, self.pose_reward)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """See `ParkEnv.step`; the reward is exactly that of `compute_reward`."""
        seen, _, terminated, truncated, info = super().step(action)
        goals = seen["achieved_goal"], seen["desired_goal"]
        reward = float(self.compute_reward(*goals, info))
        return seen, reward, terminated, truncated, info


def shared_goal_env(config: EnvConfig, pose_reward: PoseReward) -> GoalParking:
    """The environment of a configuration, made and compiled only once."""
    return share_goals(GoalParking, shared_env(config), pose_reward)


@functools.lru_cache(maxsize=32)
def share_goals(
    kind: type[GoalEnv], parking: ParkingEnv, pose_reward: PoseReward
) -> GoalEnv:
    """A task of one kind around an environment, the same for the same arguments."""
    return kind(parking, pose_reward)
