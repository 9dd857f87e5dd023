"""Flags of the trainers: presets give defaults, wherever in the line they stand."""

import dataclasses

import pytest

from carpark_mj.files import write_json
from carpark_mj.training.ppo.config import RUN_SETTINGS
from carpark_mj.training.ppo.parts import PRESETS, summaries
from carpark_mj.training.run_folder import describe, read_settings


def read(*arguments):
    return read_settings(
        PRESETS["cpu"], PRESETS, arguments, None, RUN_SETTINGS, summaries()
    )


def test_a_preset_gives_the_defaults_and_flags_change_them():
    assert read() == PRESETS["cpu"]
    assert read("--preset", "auto") == PRESETS["cpu"]
    changed = read("--seed", "3", "--preset=square", "--env.num-agents", "6")
    expected = dataclasses.replace(
        PRESETS["square"],
        seed=3,
        env=dataclasses.replace(PRESETS["square"].env, num_agents=6),
    )
    assert changed == expected


def test_settings_need_to_fit_the_named_preset_only():
    # 8192 lots x 7 agents divide by 28, the default's 128 x 2 do not.
    assert read("--preset", "square", "--num-minibatches", "28").num_lots == 8192
    with pytest.raises(ValueError, match="256 must be a multiple of"):
        read("--num-minibatches", "28")


def test_the_whole_help_lists_every_setting(capsys):
    with pytest.raises(SystemExit) as stop:
        read("--preset", "gpu", "--help-all")
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    for flag in ("--seed INT", "--clip FLOAT", "--env.num-agents INT"):
        assert flag in printed
    assert "(default: 1024)" in printed  # the preset's


def test_a_resumed_run_keeps_its_preset(tmp_path):
    config = dataclasses.replace(PRESETS["cpu"], seed=4)
    write_json(tmp_path / "config.json", describe(config))
    flags = ["--resume", str(tmp_path), "--preset"]
    assert read(*flags, "cpu").seed == 4
    with pytest.raises(ValueError, match="keeps its own settings: drop --preset"):
        read(*flags, "square")


def test_a_resumed_run_is_given_no_setting_even_if_it_is_the_preset_s(tmp_path):
    config = dataclasses.replace(PRESETS["square"], seed=4)
    write_json(tmp_path / "config.json", describe(config))
    default = read()
    for flag in (
        f"--num-steps={default.num_steps}",
        f"--env.num-agents={default.env.num_agents}",
    ):
        name = flag.partition("=")[0]
        with pytest.raises(ValueError, match=f"keeps its own settings: drop {name}"):
            read("--resume", str(tmp_path), flag)
    assert read("--resume", str(tmp_path), "--time-limit", "3").seed == 4
