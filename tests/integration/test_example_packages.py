"""The packages of `examples/extensions`, as their users have them.

Six of them in one training, so that they are seen to go together; craft that hover and
a planner have theirs in `test_hover` and `test_pure_pursuit`.
"""

import csv
import json
import tomllib

import pytest
from helpers.packages import PACKAGES, run, train

pytestmark = pytest.mark.slow

NAMES = sorted(path.name for path in PACKAGES.iterdir() if path.is_dir())
TOGETHER = ("court", "haste", "nearest_wall", "peak_lateral", "rail_cart", "taxi")
FLAGS = (
    *("--env.layout", "court,street", "--env.vehicle", "taxi"),
    *("--env.reward.extra.haste", "0.01", "--env.reward.extra.haste.above", "0.5"),
    *("--env.observation.encoding", "nearest_wall"),
    *("--env.observation.rays.count", "4", "--env.metrics.extra", "peak_lateral"),
    *("--env.movers", "rail_cart", "--env.physics", "bicycle"),
    # So that episodes end.
    *("--unroll-length", "64", "--num-steps", "1536", "--minutes", "0"),
    *("--env.episode.max-steps", "30", "--eval-episodes", "8"),
)


def test_there_is_one_for_each_of_the_eight_kinds_of_parts():
    assert len(NAMES) == 8


@pytest.mark.parametrize("name", NAMES)
def test_a_package_names_its_module_as_an_entry_point(name):
    project = tomllib.loads((PACKAGES / name / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["carpark_mj.extensions"]
    assert points == {name: name}
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["only-include"] == [f"{name}.py"]
    assert (PACKAGES / name / f"{name}.py").is_file()


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates with six packages, evaluated."""
    return train(*FLAGS, extensions=TOGETHER, runs=tmp_path_factory.mktemp("runs"))


def test_a_reward_term_and_a_metric_are_in_the_log_of_a_training(trained):
    with (trained / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3
    assert all(float(row["reward/haste"]) < 0.0 for row in rows)
    assert float(rows[-1]["episode/return_haste"]) < 0.0
    assert float(rows[-1]["episode/peak_lateral"]) > 0.0


def test_they_and_the_layouts_are_in_an_evaluation(trained):
    found = json.loads((trained / "evaluation.json").read_text())
    summary = found["summary"]
    assert {*found["families"]} <= {"court", "street"}
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
    assert env["observation"]["encoding"] == "nearest_wall"
    assert env["observation"]["rays"]["count"] == 4
    assert (env["movers"], env["vehicle"]) == (["rail_cart"], "taxi")


def test_the_policy_is_read_back_with_them_and_refused_without(trained, tmp_path):
    flags = (str(trained), "--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("evaluate", *flags, extensions=TOGETHER)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "found" / "evaluation.json").read_text())
    for missing in ("haste", "taxi"):
        others = [name for name in TOGETHER if name != missing]
        done = run("evaluate", *flags, extensions=others, found=TOGETHER)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "unknown" in done.stderr
        assert repr(missing) in done.stderr


def test_courts_are_checked_by_their_name():
    done = run("layouts", "court", "--check", "20", extensions=("court",))
    assert (done.returncode, done.stdout) == (0, "court: 20 lots, 0 problems\n")
