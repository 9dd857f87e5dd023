"""A reward term and a metric of other packages, as a user of them has them."""

import csv
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ROOT / "examples" / "extensions"
NAMES = ("haste", "peak_lateral")
TINY = (
    *("--preset", "cpu", "--num-lots", "4", "--num-minibatches", "2"),
    *("--unroll-length", "64", "--num-steps", "1536", "--minutes", "0"),
    *("--env.physics", "bicycle", "--env.num-parked-cars", "2"),
    *("--env.episode.max-steps", "30", "--eval-episodes", "8", "--video-seconds", "0"),
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
)
HASTE = ("--env.reward.extra.haste", "0.01", "--env.reward.extra.haste.above", "0.5")


def run(*arguments, extensions=NAMES):
    paths = [str(ROOT), *(str(PACKAGES / name) for name in NAMES)]
    given = {
        "PYTHONPATH": os.pathsep.join(paths),
        "CARPARK_MJ_EXTENSIONS": ",".join(extensions),
        "COLUMNS": "200",
    }
    return subprocess.run(
        [sys.executable, "-m", "carpark_mj", *arguments],
        cwd=ROOT,
        env=os.environ | given,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates with both, evaluated."""
    runs = tmp_path_factory.mktemp("runs")
    folder = ("--runs-dir", str(runs), "--name", "calm")
    flags = (*HASTE, "--env.metrics.extra", "peak_lateral")
    done = run("train", *TINY, *flags, *folder)
    assert done.returncode == 0, done.stderr
    return runs / "calm"


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
        done = run("evaluate", *flags, extensions=others)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert f"unknown {kind} {missing!r}" in done.stderr


@pytest.mark.parametrize("name", NAMES)
def test_the_packages_name_their_module_as_an_entry_point(name):
    project = tomllib.loads((PACKAGES / name / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["carpark_mj.extensions"]
    assert points == {name: name}
    assert (PACKAGES / name / f"{name}.py").is_file()
