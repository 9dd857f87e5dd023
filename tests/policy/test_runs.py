"""Run folders: configs survive JSON, bad ones are refused."""

import dataclasses
import json

import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.policy import runs
from learners.ppo.config import PPOConfig
from learners.ppo.presets import PRESETS


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_config_survives_json(name):
    config = dataclasses.replace(PRESETS[name], seed=5, learning_rate=1e-3)
    text = json.dumps(dataclasses.asdict(config))
    assert runs.from_dict(PPOConfig, json.loads(text)) == config


def test_unknown_settings_are_named():
    data = dataclasses.asdict(EnvConfig()) | {"num_cars": 3}
    with pytest.raises(ValueError, match="num_cars"):
        runs.from_dict(EnvConfig, data)


def test_impossible_settings_are_refused_on_reading():
    data = dataclasses.asdict(EnvConfig())
    data["sim"]["ctrl_dt"] = 0.015
    with pytest.raises(ValueError, match=r"ctrl_dt.*0\.015"):
        runs.from_dict(EnvConfig, data)


def test_a_config_that_is_no_dictionary_is_refused():
    with pytest.raises(ValueError, match="EnvConfig needs a dictionary"):
        runs.from_dict(EnvConfig, [1])
