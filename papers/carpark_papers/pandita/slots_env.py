"""The task of Pandita 2022 for Gymnasium: `carpark_mj/Slots-v0`."""

import dataclasses

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import layout_config
from carpark_mj.wrappers.goal import ParkGoalEnv, ParkGoalVectorEnv
from carpark_mj.wrappers.gymnasium_env import one_agent
from carpark_mj.wrappers.options import Options, configure

SLOTS_OPTIONS = (
    *("config", "layout", "parked_cars"),
    *("max_episode_steps", "discrete", "details"),
)


def slots_config(options: Options) -> EnvConfig:
    """The configuration of one agent that options ask for."""
    config = one_agent(configure({"config": "pandita", **options}, SLOTS_OPTIONS))
    if "parked_cars" not in options and "layout" in options:
        others = layout_config(config.layout).min_bays - 1
        config = dataclasses.replace(config, num_parked_cars=others)
    return config


class SlotsEnv(ParkGoalEnv):
    """One agent parks in a slot; as `ParkGoalEnv`, but for these.

    - observation: both `observation` and `achieved_goal` are the car's features.
    - end: terminated when crashed or with the goal reached, truncated after 150 steps.
    - options: `config`, by default `pandita`, `layout`, and `parked_cars`, by default
      one in every slot but the goal's.
    """

    _config = staticmethod(slots_config)


class SlotsVectorEnv(ParkGoalVectorEnv):
    """`carpark_mj/Slots-v0` many times; see `ParkVectorEnv` and `SlotsEnv`."""

    _config = staticmethod(slots_config)
