"""The command `carpark_mj`: what it lists is there, what it does not know is said."""

import re
import sys

import pytest
from helpers.programs import exit_code

from carpark_mj import __main__ as command
from carpark_mj import __version__
from carpark_mj.config import LAYOUTS
from carpark_mj.extensions import Entry
from carpark_mj.pretrained import pretrained_names
from carpark_mj.programs import COMMANDS, STUDY_PROGRAMS, study
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.vehicle import VEHICLES


@pytest.fixture
def programs(monkeypatch):
    """The programs of `carpark_mj study`, to be changed; none at first."""
    list(STUDY_PROGRAMS)  # of installed extensions
    monkeypatch.setattr(STUDY_PROGRAMS, "_parts", {})
    return STUDY_PROGRAMS


@pytest.mark.parametrize("name", COMMANDS)
def test_a_listed_program_is_there_and_says_what_it_does(name):
    assert callable(COMMANDS[name].load())
    assert COMMANDS[name].summary


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_help_lists_every_program(arguments, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["carpark_mj", *arguments])
    with pytest.raises(SystemExit) as end:
        command.main()
    assert not end.value.code
    printed = capsys.readouterr().out
    assert all(f"\n  {name} " in printed for name in COMMANDS)


def test_the_version_is_that_of_the_package(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["carpark_mj", "--version"])
    with pytest.raises(SystemExit) as end:
        command.main()
    assert not end.value.code
    assert capsys.readouterr().out == f"carpark_mj {__version__}\n"


def test_the_completion_knows_every_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["carpark_mj", "--completion"])
    with pytest.raises(SystemExit):
        command.main()
    printed = capsys.readouterr().out
    offered = re.findall(r'-W "([^"]*)"', printed)[0].split()
    nested = [name for name in COMMANDS if " " in name]
    assert sorted([*offered, *nested]) == sorted(COMMANDS)
    assert all(f'"{name}"' in printed for name in nested)


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("layouts", LAYOUTS),
        ("environments", ENVIRONMENTS),
        ("vehicles", VEHICLES),
        ("policies", pretrained_names()),
        ("presets", PRESETS),
    ],
)
def test_all_names_of_a_kind_are_listed(kind, names, capsys):
    assert exit_code("list", [kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines} == {*names}
    assert all(len(line.split()) > 1 for line in lines)
    if kind in COMMANDS:  # without anything to do
        assert exit_code(kind, []) == 0
        assert capsys.readouterr().out.splitlines() == lines


def test_an_unknown_program_is_refused_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["carpark_mj", "trian"])
    with pytest.raises(SystemExit) as end:
        command.main()
    assert end.value.code == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "'trian'" in line
    assert "train" in line


def test_without_any_study_it_is_said_what_to_install(programs, capsys):
    for words in ([], ["tanner"]):
        assert exit_code("study", words) == 2
        [line] = capsys.readouterr().err.splitlines()
        assert "pip install ./papers" in line


def test_a_program_of_an_extension_is_called_with_its_arguments(
    programs, monkeypatch, capsys
):
    monkeypatch.setattr(sys, "argv", ["carpark_mj study"])
    programs.register("count", Entry("builtins:len", "counts"))
    assert exit_code("study", []) == 0
    assert "count  counts" in capsys.readouterr().out
    assert study(["count", "--list"]) == 1
    assert sys.argv == ["carpark_mj study count", "--list"]
    assert exit_code("study", ["county"]) == 2
    assert "'count'" in capsys.readouterr().err
