"""Run folders: configs survive JSON, bad ones are refused."""

import dataclasses
import json

import numpy as np
import pytest
from helpers.mutating import with_junk

from carpark_mj.config import EnvConfig
from carpark_mj.policy import checkpoints, loading, runs
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_config_survives_json(name):
    config = dataclasses.replace(PRESETS[name], seed=5, learning_rate=1e-3)
    text = json.dumps(dataclasses.asdict(config))
    assert runs.from_dict(PPOConfig, json.loads(text)) == config


def test_unknown_settings_are_named():
    data = dataclasses.asdict(EnvConfig()) | {"num_cars": 3}
    with pytest.raises(ValueError, match="num_cars"):
        runs.from_dict(EnvConfig, data)


@dataclasses.dataclass(frozen=True)
class Eye:
    reach: float = 1.0


@dataclasses.dataclass(frozen=True)
class Seeing:
    eye: Eye = dataclasses.field(default_factory=Eye)
    other: Eye | None = None


@pytest.mark.parametrize("other", [None, Eye(2.0)])
def test_a_config_inside_a_config_or_none_survives_json(other):
    text = json.dumps(dataclasses.asdict(Seeing(Eye(3.0), other)))
    assert runs.from_dict(Seeing, json.loads(text)) == Seeing(Eye(3.0), other)


def test_an_older_checkpoint_is_refused_before_it_is_read(tmp_path):
    header = {"config": {"env": {"gone": 1}}, "env_steps": 8}
    path = runs.save_checkpoint(tmp_path / "x", {"a": np.zeros(1)}, header, 8)
    for run in (tmp_path / "x", path):
        with pytest.raises(CheckpointError, match="unusable config"):  # not its age
            loading.load_policy(run)
    checkpoints.save(path, {"a": np.zeros(1)}, header)
    for run in (tmp_path / "x", path):
        with pytest.raises(CheckpointError, match=r"is of another carpark"):
            loading.load_policy(run)


@pytest.mark.parametrize("preset", ["anywhere", "dynamic"])
def test_settings_with_junk_are_a_config_or_refused(preset):
    data = dataclasses.asdict(PRESETS[preset])
    for seed in range(300):
        try:
            config = runs.from_dict(PPOConfig, with_junk(data, seed))
        except ValueError:
            continue
        hash(config)  # so nowhere a list or a dictionary
        again = json.loads(json.dumps(dataclasses.asdict(config)))
        assert runs.from_dict(PPOConfig, again) == config
