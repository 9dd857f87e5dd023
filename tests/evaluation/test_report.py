"""The report: files that add up to what was found, and tables on the screen."""

import csv
import dataclasses
import json
import re
from pathlib import Path

import pytest
from helpers.disks import no_printing
from rich.console import Console

from carpark_mj.cli.evaluate import EvaluateConfig, Task, report, subfolder
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import complete_row, summarize
from carpark_mj.evaluation.report import (
    print_groups,
    print_metrics,
    print_report,
    print_table,
    write_evaluation,
)
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.policy.named import zero_policy
from carpark_mj.types import ENDINGS

BICYCLES = EnvConfig(physics="bicycle")


def test_what_is_written_adds_up_to_what_is_written(everything, tmp_path, capsys):
    table, data = write_evaluation(tmp_path, everything, {})
    words = ("family", "vehicle")
    with table.open(newline="") as file:
        rows = [
            {name: float(x) for name, x in row.items() if name not in words}
            for row in csv.DictReader(file)
        ]
    stored = json.loads(data.read_text())
    assert json.dumps(summarize(rows)) == json.dumps(stored["summary"])  # NaN like NaN
    assert "families" not in stored  # of a single lot
    assert {row["family"] for row in everything.episodes} == {"square"}
    print_metrics(everything.summary)
    printed = capsys.readouterr().out
    for name in ("nearest car", "min collision time agent", "worst 5 %"):
        assert name in printed


def test_the_first_table_tells_outcomes_and_how_episodes_went(everything, capsys):
    rate = {"rate": 0.25, "low": 0.1, "high": 0.4, "count": 1}
    driven = {"time_to_park": 12.34, "path": 17.26, "gear_changes": 1.5}
    driven |= {"final_distance": 0.123, "final_heading": 0.1, "final_speed": 0.456}
    summary = dict.fromkeys(ENDINGS, rate) | driven | {"wrong_way_share": 0.037}
    print_table(everything.summary | summary, "a title")
    printed = " ".join(capsys.readouterr().out.split())
    texts = ("a title: 90 episodes", "25.0%", "10.0% … 40.0%", "timed out", "12.3 s")
    texts += ("17.3 m", "1.5 gear changes", "0.12 m", "5.7 deg", "0.46 m/s")
    for text in (*texts, "3.7% of the distance driven against the lanes"):
        assert text in printed


def test_every_crash_stands_in_a_row_of_what_was_hit(capsys):
    hits = [f"hit_{kind.label}" for kind in ObstacleKind]
    nothing = {"length": 10.0, **dict.fromkeys((*ENDINGS, *hits), 0.0), "crashed": 1.0}
    rows = [complete_row(nothing | {hit: 1.0}, 0.2) for hit in hits]
    print_table(summarize(rows), "crowded")
    printed = capsys.readouterr().out
    found = re.findall(r"│ +(hit [a-z ]+?) +│.* (\d+) │", printed)
    assert found == [(hit.replace("_", " "), "1") for hit in hits]
    assert "more hits" not in printed
    both = complete_row(nothing | {"hit_wall": 1.0, "hit_person": 1.0}, 0.2)
    print_table(summarize([*rows, both]), "crowded")
    assert "1 more hits" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("part", "stem", "column", "names"),
    [
        ("families", "families", "family", ("square_compact", "street")),
        ("agent_counts", "agents_present", "agents_present", (1, 2)),
        ("vehicles", "vehicles", "vehicle", ("city", "van")),
    ],
)
def test_parts_have_summaries_and_a_printed_table(
    part, stem, column, names, everything, tmp_path, capsys
):
    thirds = (everything.episodes[:60], everything.episodes[60:])
    parts = dict(zip(names, map(summarize, thirds), strict=True))
    result = dataclasses.replace(everything, **{part: parts})
    write_evaluation(tmp_path, result, {})
    stored = json.loads((tmp_path / "evaluation.json").read_text())[stem]
    found = {name: part["episodes"] for name, part in stored.items()}
    assert found == {str(names[0]): 60, str(names[1]): 30}
    for part in stored.values():
        rates = [part[outcome]["rate"] for outcome in ENDINGS]
        assert sum(rates) == pytest.approx(1.0)
        assert part["parked"]["low"] <= rates[0] <= part["parked"]["high"]
    print_report(result, "a title")
    assert f"by {column.replace('_', ' ')}" in capsys.readouterr().out


def test_the_file_names_the_policy(everything, tmp_path):
    config, env = EvaluateConfig("runs/a"), ParkingEnv(BICYCLES)
    policy = zero_policy(env.action_spec)
    report(config, Task("runs/a", policy, env, tmp_path), everything)
    stored = json.loads((tmp_path / "evaluation.json").read_text())
    assert stored["settings"]["policy"] == "runs/a"
    assert stored["settings"]["seed"] == 0


def test_an_evaluation_is_written_before_it_is_printed(
    everything, tmp_path, monkeypatch
):
    env = ParkingEnv(BICYCLES)
    task = Task("zero", zero_policy(env.action_spec), env, tmp_path)
    monkeypatch.setattr(Console, "print", no_printing)
    with pytest.raises(BrokenPipeError):
        report(EvaluateConfig("zero"), task, everything)
    assert {"evaluation.csv", "evaluation.json"} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        ({"num_agents": 1, "seed": 3}, "num_agents-1_seed-3"),
        (
            {"rule": "strict", "layout": "street,my/yard.json"},
            "layout-street,my%2Fyard.json_rule-strict",
        ),
        ({"episodes": 4096, "horizon": 100.0}, "episodes-4096_horizon-100.0"),
        ({"layout": "my-yard.json"}, "layout-my-yard.json"),
        ({"movers": ("cart", "drivers:number=4")}, "movers-cart+drivers:number=4"),
    ],
)
def test_results_of_other_tasks_are_in_folders_by_flags(flags, name):
    found = subfolder(EvaluateConfig(run="runs/a", **flags))
    assert found == Path("evaluations") / name


def test_folders_of_long_flags_differ_and_can_be_made(tmp_path):
    layouts = [",".join(["street"] * 60 + [last]) for last in ("lot", "angled")]
    found = {subfolder(EvaluateConfig("runs/a", layout=name)) for name in layouts}
    assert len(found) == 2
    for folder in found:
        (tmp_path / folder).mkdir(parents=True)


def test_names_are_printed_as_they_are(everything, capsys):
    name = "x[/red][b]"
    print_table(everything.summary, name)
    print_groups("family", {name: everything.summary, "all": everything.summary})
    printed = capsys.readouterr().out
    assert f"{name}:" in printed
    assert f"│ {name} " in printed
