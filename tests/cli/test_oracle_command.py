"""`carpark_mj oracle`: a table and a file of what is possible in held-out lots."""

import csv

import pytest
from helpers.programs import assert_refused
from helpers.programs import oracle as main

from carpark_mj.cli.oracle import OUTCOMES, describe
from carpark_mj.registry import environment


@pytest.fixture(autouse=True)
def ompl():
    pytest.importorskip("ompl")


def row(lot, agents, outcome, family="street"):
    which = {"lot": lot, "family": family, "agents_present": agents}
    return which | {"outcome": outcome}


def test_the_table_counts_agents_and_lots_by_family():
    rows = [row(0, 2, "in time"), row(0, 2, "late")]
    rows += [row(1, 2, "in time"), row(1, 2, "in time")]
    rows += [row(2, 1, "impossible", "dead_end")]
    lines = [line.split(" | ") for line in describe(rows).splitlines()[2:]]
    assert [line[:7] for line in lines] == [
        ["| dead_end", "1", "1", "0.0", "0.0", "0.0", "100.0"],
        ["| street", "2", "2", "75.0", "25.0", "0.0", "0.0"],
    ]
    assert [line[7].split()[0] for line in lines] == ["0.0", "50.0"]


def test_the_command_writes_a_row_for_each_agent(tmp_path, capsys):
    flags = "--environment square --layout square_compact --num-agents 2 --lots 1"
    assert main([*flags.split(), "--out", str(tmp_path / "new")]) == 0
    with (tmp_path / "new" / "oracle.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(r["lot"], r["agent"]) for r in rows] == [("0", "0"), ("0", "1")]
    task = environment("square")
    seconds = task.episode.max_steps * task.sim.ctrl_dt
    for r in rows:
        assert r["outcome"] in OUTCOMES
        assert (r["outcome"] == "in time") == (float(r["arrival"]) <= seconds)
    assert "| square_compact | 2 | 1 |" in capsys.readouterr().out


def test_what_cannot_be_planned_is_refused(capsys):
    reason = "the planner needs fixed goals"
    assert_refused(capsys, "oracle", ["--environment", "dynamic"], reason)
