"""An observation field of another package, as a user of it has it."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "examples" / "extensions" / "nearest_wall"
TINY = (
    *("--preset", "cpu", "--num-lots", "4", "--num-minibatches", "2"),
    *("--unroll-length", "4", "--num-steps", "96", "--env.physics", "bicycle"),
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
    *("--eval-episodes", "0", "--video-seconds", "0"),
    *("--env.num-parked-cars", "2", "--env.observation.rays.count", "4"),
)


def run(*arguments, extensions="nearest_wall"):
    given = {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(PACKAGE)]),
        "CARPARK_MJ_EXTENSIONS": extensions,
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
    """The folder of a few updates of cars that see the nearest wall."""
    runs = tmp_path_factory.mktemp("runs")
    flags = ("--env.observation.encoding", "nearest_wall")
    done = run("train", *TINY, *flags, "--runs-dir", str(runs), "--name", "shy")
    assert done.returncode == 0, done.stderr
    return runs / "shy"


def test_ppo_trains_on_it_and_the_policy_is_read_back(trained, tmp_path):
    seen = json.loads((trained / "config.json").read_text())["config"]["env"]
    assert seen["observation"]["encoding"] == "nearest_wall"
    assert seen["observation"]["rays"]["count"] == 4
    flags = ("--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("evaluate", str(trained), *flags)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "found" / "evaluation.json").read_text())


def test_without_it_the_policy_is_refused_in_one_line(trained, tmp_path):
    done = run("evaluate", str(trained), "--out", str(tmp_path), extensions="")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "unknown observation encoding 'nearest_wall'" in done.stderr


def test_the_package_names_its_module_as_an_entry_point():
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["carpark_mj.extensions"]
    assert points == {"nearest_wall": "nearest_wall"}
    assert (PACKAGE / "nearest_wall.py").is_file()
