"""Options by keyword: what they set, and what is refused."""

import dataclasses

from carpark_mj.config import REWARDS, EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.registry import SQUARE
from carpark_mj.wrappers.options import configure, share


def test_every_option_sets_its_field():
    found = configure(
        {
            "layout": "square_compact",
            "agents": 3,
            "parked_cars": 5,
            "rule": "precise",
            "reward": "pose",
            "physics": "bicycle",
        }
    )
    assert found == EnvConfig(
        layout="square_compact",
        num_agents=3,
        num_parked_cars=5,
        episode=EpisodeConfig(parked_rule="precise"),
        reward=REWARDS["pose"],
        physics="bicycle",
    )


def test_options_change_a_config_or_a_named_environment():
    assert configure({"config": "square"}) == SQUARE
    few = configure({"config": SQUARE, "agents": 2})
    assert few == dataclasses.replace(SQUARE, num_agents=2)
    assert configure({}) == EnvConfig()


def test_an_environment_is_made_once():
    config = EnvConfig(num_agents=1)
    assert share(ParkingEnv, config) is share(ParkingEnv, config)
