"""Options by keyword: what they set, and what is refused."""

import dataclasses

import pytest

from carpark_mj.config import REWARDS, EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.registry import SQUARE
from carpark_mj.wrappers.options import OPTIONS, configure, share


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


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"agent": 2}, TypeError, "keyword argument 'agent'; choose from .*'agents'"),
        ({"layout": "mars"}, ValueError, "unknown layout 'mars'; choose from"),
        ({"rule": "near"}, ValueError, "unknown parked rule 'near'; choose from"),
        ({"reward": "none"}, ValueError, "unknown reward 'none'; choose from"),
        ({"physics": "box2d"}, ValueError, "unknown physics 'box2d'; choose from"),
        ({"agents": 0}, ValueError, "num_agents must be at least 1, not 0"),
        ({"config": "moon"}, ValueError, "unknown environment 'moon'; choose from"),
        ({"config": 3}, ValueError, "an EnvConfig or a name, not 3"),
    ],
)
def test_impossible_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        configure(options, OPTIONS)


def test_an_environment_is_made_once():
    assert share(ParkingEnv, EnvConfig(num_agents=1)) is share(
        ParkingEnv, EnvConfig(num_agents=1)
    )
