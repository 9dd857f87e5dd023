"""The scripts: bad input ends each of them alike, and what they count and compare."""

import shutil
from pathlib import Path

import pytest

import figures
import physics_report
import referee
from peers import Subject, comparison, take_turns


@pytest.mark.parametrize(
    ("script", "flags", "said"),
    [
        (physics_report, ["--preset", "tank"], "Unrecognized options: --preset"),
        (physics_report, ["--presets", "tank"], "unknown vehicle 'tank'; choose from"),
        (referee, ["--output", "folder"], "Unrecognized options: --output, folder"),
        (referee, ["--out"], "--out"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(script, flags, said, capsys):
    assert script.main(flags) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"{script.__name__}: ")
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("script", [physics_report, referee])
def test_an_unwritable_folder_is_refused_before_anything_drives(
    script, tmp_path, capsys, monkeypatch
):
    def drive(*_):
        raise AssertionError("it drove")

    monkeypatch.setattr(physics_report, "SUITE", (drive,))
    monkeypatch.setattr(referee, "trials", drive)
    (tmp_path / "file").write_text("no folder")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert script.main(["--out", str(out)]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"{script.__name__}: cannot use {tmp_path}")
        assert error.count("\n") == 1
    taken = tmp_path / "taken"
    for name in ("report.md", "referee.md"):
        (taken / name).mkdir(parents=True)
    assert script.main(["--out", str(taken)]) == 2
    assert "Is a directory" in capsys.readouterr().err


# Peers: taking turns, and the table


def test_subjects_take_turns_after_they_have_compiled():
    calls = []
    names = ("a", "b")
    found = [Subject(name, 3, lambda name=name: calls.append(name)) for name in names]
    measured = take_turns(found, rounds=2, seconds=1e-4)
    assert calls[:4] == ["a", "a", "b", "b"]
    turns = [name for i, name in enumerate(calls) if i == 0 or calls[i - 1] != name]
    assert turns == ["a", "b", "a", "b", "a", "b"]
    assert {name: len(rates) for name, rates in measured.items()} == {"a": 2, "b": 2}
    assert min(min(rates) for rates in measured.values()) > 0


def test_the_table_compares_the_best_and_gives_ranges():
    pair = [Subject(name, 1024, lambda: None) for name in ("theirs", "ours")]
    rates = {"theirs": [100_000.0, 80_000.0], "ours": [60_000.0, 90_000.0]}
    theirs, ours = comparison(pair, rates)
    assert (theirs["steps/s"], theirs["ratio"]) == ("100,000", "")
    assert (ours["steps/s"], ours["ratio"]) == ("90,000", "0.9 (0.6 … 1.12)")


def test_every_figure_is_drawn_from_its_table(tmp_path, capsys):
    docs = Path(__file__).parents[2] / "docs" / "results"
    for table, *_ in figures.FIGURES.values():
        shutil.copy(docs / table, tmp_path)
    assert figures.main(["--tables", str(tmp_path)]) == 0
    for name in figures.FIGURES:
        text = (tmp_path / f"{name}.svg").read_text()
        assert "<svg" in text
        assert (docs / f"{name}.svg").is_file()
    assert figures.main(["--tables", str(tmp_path / "none")]) != 0
    assert "none" in capsys.readouterr().err
