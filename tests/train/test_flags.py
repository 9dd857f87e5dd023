"""Flags of the trainers: presets give defaults, wherever in the line they stand."""

import dataclasses

import pytest

from carpark_mj.registry import TANNER_FIXED
from flags import read_flags
from presets import PRESETS
from q_presets import Q_PRESETS


def read(*arguments):
    return read_flags(PRESETS["cpu"], PRESETS, arguments, None)


def test_a_preset_gives_the_defaults_and_flags_change_them():
    assert read() == PRESETS["cpu"]
    assert read("--preset", "auto") == PRESETS["cpu"]
    changed = read("--seed", "3", "--preset=tanner-fixed", "--env.num-agents", "6")
    expected = dataclasses.replace(
        PRESETS["tanner-fixed"],
        seed=3,
        env=dataclasses.replace(TANNER_FIXED, num_agents=6),
    )
    assert changed == expected


def test_settings_need_to_fit_the_named_preset_only(capsys):
    # 128 lots x 7 agents divide by 28, the default's 64 x 2 do not.
    assert read("--preset", "tanner-fixed", "--num-minibatches", "28").num_lots == 128
    with pytest.raises(SystemExit):
        read("--num-minibatches", "28")
    assert "128 must be a multiple of" in capsys.readouterr().err


def test_other_trainers_have_their_own_presets(capsys):
    default = Q_PRESETS["tanner-qlearning"]
    name = "tanner-qlearning-rings"
    assert read_flags(default, Q_PRESETS, ["--preset", name], None) == Q_PRESETS[name]
    with pytest.raises(SystemExit):
        read_flags(default, Q_PRESETS, ["--preset", "cpu"], None)
    assert "tanner-qlearning-rings" in capsys.readouterr().err


def test_the_help_is_of_the_named_preset(capsys):
    with pytest.raises(SystemExit) as stop:
        read("--preset", "tanner-fixed-original", "--help")
    assert stop.value.code == 0
    assert "12800000" in capsys.readouterr().out
