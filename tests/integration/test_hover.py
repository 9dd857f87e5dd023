"""A back end of another package, as a user of it has it."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "examples" / "extensions" / "hover"
TINY = (
    *("--preset", "cpu", "--num-lots", "4", "--num-minibatches", "2"),
    *("--unroll-length", "4", "--num-steps", "96", "--env.physics", "hover"),
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
    *("--eval-episodes", "0", "--video-seconds", "0"),
    *("--env.num-parked-cars", "2"),
)


def run(*arguments, extensions="hover"):
    given = {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(PACKAGE)]),
        "CARPARK_MJ_EXTENSIONS": extensions,
        "COLUMNS": "200",
    }
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=os.environ | given,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates of craft that hover."""
    runs = tmp_path_factory.mktemp("runs")
    done = run("train/ppo.py", *TINY, "--runs-dir", str(runs), "--name", "craft")
    assert done.returncode == 0, done.stderr
    return runs / "craft"


def test_ppo_trains_on_it_and_the_policy_is_read_back(trained, tmp_path):
    flags = ("--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("eval/evaluate.py", str(trained), *flags)
    assert done.returncode == 0, done.stderr
    assert "hover physics" in done.stdout
    assert json.loads((tmp_path / "found" / "evaluation.json").read_text())


@pytest.mark.parametrize(
    ("extensions", "flags", "named"),
    [
        ("hover", ("--physics", "mjx"), "other controls"),
        ("", (), "unknown physics 'hover'"),
    ],
)
def test_elsewhere_the_policy_is_refused_in_one_line(trained, extensions, flags, named):
    done = run("eval/evaluate.py", str(trained), *flags, extensions=extensions)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert named in done.stderr


def test_the_package_names_its_module_as_an_entry_point():
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["carpark_mj.extensions"]
    assert points == {"hover": "hover"}
    assert (PACKAGE / "hover.py").is_file()
