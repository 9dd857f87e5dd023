"""The command `carpark_mj`: what it lists is there, what it does not know is said."""

import sys

import pytest
from helpers.programs import exit_code

from carpark_mj import __main__ as command
from carpark_mj.programs import COMMANDS, STUDY_PROGRAMS, study

ENTRIES = {**COMMANDS, **STUDY_PROGRAMS}


@pytest.mark.parametrize("name", ENTRIES)
def test_a_listed_program_is_there_and_says_what_it_does(name):
    assert callable(ENTRIES[name].load())
    assert ENTRIES[name].summary


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_help_lists_every_program(arguments, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["carpark_mj", *arguments])
    with pytest.raises(SystemExit) as end:
        command.main()
    assert not end.value.code
    printed = capsys.readouterr().out
    assert all(f"\n  {name} " in printed for name in COMMANDS)


def test_an_unknown_program_is_refused_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["carpark_mj", "trian"])
    with pytest.raises(SystemExit) as end:
        command.main()
    assert end.value.code == 2
    assert exit_code(study, ["sac_"]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert "'trian'" in first
    assert "train" in first
    assert "'sac_'" in second
    assert "'sac'" in second


def test_a_program_of_a_study_is_called_with_its_arguments(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["carpark_mj study"])
    assert exit_code(study, ["slots", "--list"]) == 0
    assert sys.argv == ["carpark_mj study slots", "--list"]
