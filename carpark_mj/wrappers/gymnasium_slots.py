"""The task of Pandita 2022 for Gymnasium: `carpark_mj/Slots-v0`."""

import dataclasses

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import layout_config
from carpark_mj.wrappers.batch import LotEnv
from carpark_mj.wrappers.goal import PoseReward
from carpark_mj.wrappers.gymnasium_env import one_agent
from carpark_mj.wrappers.gymnasium_goal import ParkGoalEnv, share_goals
from carpark_mj.wrappers.gymnasium_vector import ParkGoalVectorEnv
from carpark_mj.wrappers.options import Options, configure, shared_env
from carpark_mj.wrappers.slots import PANDITA_REWARD, SlotsGoalParking

SLOTS_OPTIONS = ("config", "layout", "parked_cars")


class SlotsEnv(ParkGoalEnv):
    """One agent parks in a slot; as `ParkGoalEnv`, but for these.

    - observation: both `observation` and `achieved_goal` are the car's features.
    - reward: by default `carpark_mj.wrappers.slots.PANDITA_REWARD`.
    - end: terminated when crashed or with the goal reached, truncated after 150 steps.
    - options: `config`, by default `pandita`, `layout`, and `parked_cars`, by default
      one in every slot but the goal's.
    """

    default_reward = PANDITA_REWARD

    def _make(self, options: Options) -> LotEnv:
        return shared_slots_env(slots_config(options), self.pose_reward)


class SlotsVectorEnv(ParkGoalVectorEnv):
    """`carpark_mj/Slots-v0` many times; see `ParkVectorEnv` and `SlotsEnv`."""

    default_reward = PANDITA_REWARD

    def _make(self, options: Options) -> LotEnv:
        return shared_slots_env(slots_config(options), self.pose_reward)


def slots_config(options: Options) -> EnvConfig:
    """The configuration of one agent that options ask for.

    Raises:
        TypeError: an unknown option.
        ValueError: an impossible one.
    """
    config = one_agent(configure({"config": "pandita", **options}, SLOTS_OPTIONS))
    if "parked_cars" not in options and "layout" in options:
        others = layout_config(config.layout).min_bays - 1
        config = dataclasses.replace(config, num_parked_cars=others)
    return config


def shared_slots_env(config: EnvConfig, pose_reward: PoseReward) -> SlotsGoalParking:
    """The environment of a configuration, made and compiled only once."""
    return share_goals(SlotsGoalParking, shared_env(config), pose_reward)
