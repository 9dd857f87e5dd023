"""A layout and a car of other packages, as a user of them has them."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ROOT / "examples" / "extensions"
NAMES = ("court", "taxi")
TINY = (
    *("--preset", "cpu", "--num-lots", "4", "--num-minibatches", "2"),
    *("--unroll-length", "4", "--num-steps", "96", "--env.physics", "bicycle"),
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
    *("--eval-episodes", "0", "--video-seconds", "0"),
    *("--env.num-parked-cars", "2"),
)


def run(*arguments, extensions=NAMES):
    paths = [str(ROOT), *(str(PACKAGES / name) for name in NAMES)]
    given = {
        "PYTHONPATH": os.pathsep.join(paths),
        "CARPARK_MJ_EXTENSIONS": ",".join(extensions),
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
    """The folder of a few updates in courts and streets, in a taxi."""
    runs = tmp_path_factory.mktemp("runs")
    named = ("--env.layout", "court,street", "--env.vehicle", "taxi")
    folder = ("--runs-dir", str(runs), "--name", "yard")
    done = run("train/ppo.py", *TINY, *named, *folder)
    assert done.returncode == 0, done.stderr
    return runs / "yard"


def test_ppo_trains_in_them_and_the_policy_is_read_back(trained, tmp_path):
    flags = ("--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("eval/evaluate.py", str(trained), *flags)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "found" / "evaluation.json").read_text())
    assert {*found["families"]} <= {"court", "street"}


def test_without_them_the_names_are_refused_in_one_line(trained):
    for extensions, missing in ((("taxi",), "layout 'court'"), (("court",), "'taxi'")):
        done = run("eval/evaluate.py", str(trained), extensions=extensions)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert f"unknown {missing}" in done.stderr or missing in done.stderr


def test_courts_are_checked_by_their_name():
    done = run("-m", "carpark_mj.layouts", "court", "--check", "20")
    assert (done.returncode, done.stdout) == (0, "court: 20 keys, 0 problems\n")


@pytest.mark.parametrize("name", NAMES)
def test_the_packages_name_their_module_as_an_entry_point(name):
    project = tomllib.loads((PACKAGES / name / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["carpark_mj.extensions"]
    assert points == {name: name}
    assert (PACKAGES / name / f"{name}.py").is_file()
