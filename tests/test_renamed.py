"""Names of earlier versions are refused with what became of them."""

import copy
import dataclasses
import importlib
import pickle
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from carpark_mj import renamed
from carpark_mj.cli.evaluate import EvaluateConfig
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.layouts import LayoutsConfig
from carpark_mj.cli.scene import SceneConfig
from carpark_mj.config import (
    EnvConfig,
    GoalRewards,
    RewardConfig,
    ShareConfig,
    SimConfig,
    SpawnConfig,
    insert,
)
from carpark_mj.config.layouts import LAYOUTS
from carpark_mj.extensions import Registry
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.runs import from_dict
from carpark_mj.renamed import RENAMED, OldNames
from carpark_mj.sweeps.axes import read_axis
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.curriculum_config import CurriculumConfig

ROOT = Path(__file__).parents[1]
CONFIGS: dict[str, Any] = {
    config.__name__: config
    for config in (
        ContinuousObservation,
        CurriculumConfig,
        EnvConfig,
        EvaluateConfig,
        GoalRewards,
        LayoutsConfig,
        PPOConfig,
        RewardConfig,
        SceneConfig,
        ShareConfig,
        SimConfig,
        SpawnConfig,
    )
}
MODULES = [old for old in RENAMED if old.startswith("carpark_mj.")]
PARTS = [tuple(old.split(" ")) for old in RENAMED if " " in old]
SETTINGS = [
    tuple(old.split("."))
    for old in RENAMED
    if " " not in old and not old.startswith("carpark_mj.")
]


def says(new: str) -> str:
    """A pattern of what is said: the new name, or that it is gone."""
    return re.escape(new or "removed").replace("_", "[-_]")


def exists(name: str) -> bool:
    """Whether a dotted name is a module, or in one."""
    home, _, last = name.rpartition(".")
    return hasattr(importlib.import_module(home), last) or bool(find_spec(name))


@pytest.mark.parametrize(("config", "setting"), SETTINGS)
def test_a_former_setting_is_refused_and_what_it_became_exists(config, setting):
    cls = CONFIGS[config]
    new = RENAMED[f"{config}.{setting}"]
    fields = {field.name for field in dataclasses.fields(cls)}
    assert setting not in fields
    assert not new or " " in new or new.partition(".")[0] in fields
    flag = f"--{setting.replace('_', '-')}"
    wanted = says(new)
    with pytest.raises(ValueError, match=wanted):
        read_flags(cls, [flag, "1"])
    if issubclass(cls, OldNames):
        for refused in (
            lambda: cls(**{setting: 1}),
            lambda: from_dict(cls, {setting: 1}),
            lambda: insert(cls(), {setting: 1}),
        ):
            with pytest.raises(ValueError, match=wanted):
                refused()


@pytest.mark.parametrize(("kind", "name"), PARTS)
def test_a_former_name_of_a_part_is_refused_with_its_new_one(kind, name):
    registries = {"layout": LAYOUTS}
    assert RENAMED[f"{kind} {name}"] in registries[kind]
    with pytest.raises(ValueError, match=repr(RENAMED[f"{kind} {name}"])):
        Registry(kind)[name]


@pytest.mark.parametrize("old", MODULES)
def test_a_former_module_is_refused_with_its_new_one(old):
    new = RENAMED[old]
    assert " " in new or exists(new)
    home, _, name = old.rpartition(".")
    with pytest.raises(ImportError, match=says(new)):
        exec(f"from {home} import {name}")


def test_the_settings_below_keep_their_path():
    for words in (["--env.reward.approach", "0.15"], ["--env.reward.approach=0.15"]):
        with pytest.raises(ValueError, match=r"--env\.reward\.extra\.approach"):
            read_flags(PPOConfig, words)
    with pytest.raises(ValueError, match=r"--env\.physics"):
        read_flags(PPOConfig, ["--env.grid.points", "4"])
    with pytest.raises(ValueError, match=r"env\.reward\.extra\.approach"):
        read_axis("env.reward.approach=0.1,0.2", PPOConfig())


def test_what_never_had_a_name_is_refused_as_ever(monkeypatch):
    with pytest.raises(TypeError, match="griddle"):
        EnvConfig(griddle=1)  # pyright: ignore
    with pytest.raises(ModuleNotFoundError, match="No module named"):
        importlib.import_module("carpark_mj.nowhere")
    assert not hasattr(importlib.import_module("carpark_mj.layouts"), "nothing")
    # A class that has the setting keeps it.
    monkeypatch.setitem(renamed.RENAMED, "SimConfig.sim_dt", "other")
    assert SimConfig(sim_dt=0.005).sim_dt == 0.005


def test_configs_are_copied_and_pickled():
    config = EnvConfig(reward=RewardConfig(park=2.0))
    assert pickle.loads(pickle.dumps(config)) == copy.deepcopy(config) == config


def test_a_program_ends_with_2_and_one_line():
    words = [sys.executable, "-m", "carpark_mj.scene", "--junction", "3av-hd"]
    ended = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 2
    [line] = ended.stderr.splitlines()
    assert RENAMED["SceneConfig.junction"] in line
