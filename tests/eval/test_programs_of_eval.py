"""The scripts: bad input ends each of them alike, and what they count and compare."""

import shutil
from pathlib import Path

import pytest

import figures
import physics_report
import referee
from car_parks import by_agents
from carpark_mj.evaluation.aggregation import wilson_interval
from peers import Subject, comparison, take_turns


@pytest.mark.parametrize(
    ("script", "flags", "said"),
    [
        (physics_report, ["--preset", "tank"], "Unrecognized options: --preset"),
        (physics_report, ["--presets", "tank"], "unknown vehicle 'tank'; choose from"),
        (physics_report, ["--tyres", "square"], "square"),
        (physics_report, ["--tyres"], "tyres must name at least one"),
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

    monkeypatch.setattr(
        physics_report, "SUITES", {"brush": (drive,), "contact": (drive,)}
    )
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


# Car parks: intervals hold for parts drawn at random

PARTS, LOTS = 20, 30


def episode(part, agents, parked):
    ends = {"parked": parked, "crashed": not parked, "timed_out": False}
    ends |= {"diverged": False, "crashed_at_start": False}
    which = {"family": "san_jose", "lot": part, "agents_present": agents}
    return which | {name: float(value) for name, value in ends.items()}


def test_a_part_counts_once_however_many_lots_it_has():
    rows = [
        episode(part, agents, part < 15)  # all lots of a part end alike
        for part in range(PARTS)
        for agents in (1, 2)
        for _ in range(LOTS)
    ]
    other = {**rows[0], "family": "dragon_lake"}
    for group, found in by_agents([*rows, other], "san_jose").items():
        assert found["episodes"] == PARTS * LOTS * (2 if group == "all" else 1)
        low, high = wilson_interval(15, PARTS)
        parked = found["parked"]
        assert parked["rate"] == 0.75
        assert (parked["low"], parked["high"]) == pytest.approx((low, high), abs=0.02)


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
    core = Subject("core", 1024, lambda: None)
    other = Subject("torch", 1024, lambda: None, beside="core")
    rates = {"core": [100_000.0, 80_000.0], "torch": [60_000.0, 90_000.0]}
    lines = comparison([core, other], rates).splitlines()
    assert lines[2:] == [
        "| core | 1,024 | 100,000 |  |",
        "| torch | 1,024 | 90,000 | 0.9 (0.6 … 1.12) |",
    ]


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
