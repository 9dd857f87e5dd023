"""A reward term and a metric of other packages, as a user of them has them."""

import csv
import json

import pytest
from helpers.packages import run, train

NAMES = ("haste", "peak_lateral")
HASTE = ("--env.reward.extra.haste", "0.01", "--env.reward.extra.haste.above", "0.5")
LONG = (  # so that episodes end
    *("--unroll-length", "64", "--num-steps", "1536", "--minutes", "0"),
    *("--env.physics", "bicycle", "--env.episode.max-steps", "30"),
    *("--eval-episodes", "8"),
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates with both, evaluated."""
    flags = (*HASTE, *LONG, "--env.metrics.extra", "peak_lateral")
    return train(*flags, extensions=NAMES, runs=tmp_path_factory.mktemp("runs"))


def test_they_are_in_the_log_of_a_training(trained):
    with (trained / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3
    assert all(float(row["reward/haste"]) < 0.0 for row in rows)
    assert float(rows[-1]["episode/return_haste"]) < 0.0
    assert float(rows[-1]["episode/peak_lateral"]) > 0.0


def test_they_are_in_an_evaluation(trained):
    summary = json.loads((trained / "evaluation.json").read_text())["summary"]
    assert summary["peak_lateral"]["max"] >= summary["peak_lateral"]["median"] > 0.0
    assert summary["mean_returns"]["haste"] < 0.0
    with (trained / "evaluation.csv").open() as file:
        rows = list(csv.DictReader(file))
    most = max(float(row["peak_lateral"]) for row in rows)
    assert most == pytest.approx(summary["peak_lateral"]["max"])


def test_the_config_of_the_run_has_them(trained):
    env = json.loads((trained / "config.json").read_text())["config"]["env"]
    assert env["reward"]["extra"] == {"haste": 0.01, "haste.above": 0.5}
    assert env["metrics"]["extra"] == ["peak_lateral"]


def test_without_them_the_run_is_refused_in_one_line(trained, tmp_path):
    for missing, kind in (("haste", "reward term"), ("peak_lateral", "metric")):
        others = [name for name in NAMES if name != missing]
        flags = (str(trained), "--out", str(tmp_path))
        done = run("evaluate", *flags, extensions=others, found=NAMES)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert f"unknown {kind} {missing!r}" in done.stderr
