"""An observation field of another package, as a user of it has it."""

import json

import pytest
from helpers.packages import run, train

NAMES = ("nearest_wall",)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates of cars that see the nearest wall."""
    flags = ("--env.observation.encoding", "nearest_wall", "--env.physics", "bicycle")
    flags += ("--env.observation.rays.count", "4")
    return train(*flags, extensions=NAMES, runs=tmp_path_factory.mktemp("runs"))


def test_ppo_trains_on_it_and_the_policy_is_read_back(trained, tmp_path):
    seen = json.loads((trained / "config.json").read_text())["config"]["env"]
    assert seen["observation"]["encoding"] == "nearest_wall"
    assert seen["observation"]["rays"]["count"] == 4
    flags = ("--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("evaluate", str(trained), *flags, extensions=NAMES)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "found" / "evaluation.json").read_text())


def test_without_it_the_policy_is_refused_in_one_line(trained, tmp_path):
    done = run("evaluate", str(trained), "--out", str(tmp_path), extensions=())
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "unknown observation encoding 'nearest_wall'" in done.stderr
