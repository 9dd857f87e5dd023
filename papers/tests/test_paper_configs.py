"""Settings of the papers' environments and trainers: types, presets, files."""

import dataclasses
import math

import pytest
from helpers.bounds import beyond_bounds

from carpark_mj.layouts.base import FAMILIES
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.run_folder import read_settings
from carpark_mj.vehicle import PRESETS as CARS
from carpark_mj.vehicle import preset
from carpark_mj.vehicle.sheet import parameters_text
from carpark_papers.cederle.benchmarl.config import BenchMARLConfig
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.junction import JunctionConfig
from carpark_papers.cederle.junction.config import RasterConfig, RewardRules
from carpark_papers.pandita.sac.config import SACConfig
from carpark_papers.tanner.grid import GridConfig
from carpark_papers.tanner.indices import IndexObservation
from carpark_papers.tanner.observation import TannerObservation, TannerShare, ViewConfig
from carpark_papers.tanner.q_learning.config import (
    Q_PRESETS,
    Q_SUMMARIES,
    QLearningConfig,
)

TRAINERS = (QLearningConfig, SACConfig)
CLASSES = (
    *(JunctionConfig, RasterConfig, RewardRules, TannerObservation, IndexObservation),
    *(FAMILIES["slots"], *TRAINERS, DQNConfig, BenchMARLConfig),
    *(GridConfig, ViewConfig, TannerShare),
)
JUNK = (object(), b"x", 1j, [1], {"a": 1}, (object(),))


@pytest.mark.parametrize("cls", CLASSES)
def test_no_field_takes_another_type_or_a_number_beyond_its_bounds(cls):
    for field in dataclasses.fields(cls):
        for junk in JUNK:
            with pytest.raises(ValueError, match=rf"\b{field.name}\b.* not "):
                cls(**{field.name: junk})
    for name, value in beyond_bounds(cls):
        with pytest.raises(ValueError, match=rf"\b{name}\b"):
            cls(**{name: value})


@pytest.mark.parametrize("cls", TRAINERS)
def test_trainers_refuse_impossible_names_seeds_and_numbers(cls):
    for name in ("../../x", "a/b", "..", " ", "a\nb"):
        with pytest.raises(ValueError, match="name must be the name of one folder"):
            cls(name=name)
    with pytest.raises(ValueError, match="seed must lie in"):
        cls(seed=2**32)
    for field in dataclasses.fields(cls):
        for value in (math.nan, math.inf, 1e39):
            if isinstance(field.default, float):
                with pytest.raises(ValueError, match=rf"^{field.name} must "):
                    cls(**{field.name: value})


def test_trainers_have_their_own_presets():
    default = Q_PRESETS["tanner-qlearning"]
    name = "tanner-qlearning-rings"
    arguments = (default, Q_PRESETS, ["--preset", name], None, Q_SUMMARIES)
    assert read_settings(*arguments) == Q_PRESETS[name]
    with pytest.raises(ValueError, match=r"'cpu' .*tanner-qlearning-rings"):
        read_settings(default, Q_PRESETS, ["--preset", "cpu"], None, Q_SUMMARIES)


@pytest.mark.parametrize("name", ["tanner-fixed-original", "tanner-dynamic"])
def test_presets_of_ppo_are_found_by_name(name):
    assert PRESETS[name].preset == name


def test_a_junction_keeps_the_parameters_of_a_vehicle_file(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text(parameters_text("my_car", CARS["compact"]))
    junction = JunctionConfig(vehicle=str(file))
    file.unlink()
    assert preset(junction.vehicle) == CARS["compact"]
