"""A layout and a car of other packages, as a user of them has them."""

import json

import pytest
from helpers.packages import run, train

NAMES = ("court", "taxi")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates in courts and streets, in a taxi."""
    named = ("--env.layout", "court,street", "--env.vehicle", "taxi")
    flags = (*named, "--env.physics", "bicycle")
    return train(*flags, extensions=NAMES, runs=tmp_path_factory.mktemp("runs"))


def test_ppo_trains_in_them_and_the_policy_is_read_back(trained, tmp_path):
    flags = ("--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("evaluate", str(trained), *flags, extensions=NAMES)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "found" / "evaluation.json").read_text())
    assert {*found["families"]} <= {"court", "street"}


def test_without_them_the_names_are_refused_in_one_line(trained):
    for extensions, missing in ((("taxi",), "layout 'court'"), (("court",), "'taxi'")):
        done = run("evaluate", str(trained), extensions=extensions, found=NAMES)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert f"unknown {missing}" in done.stderr or missing in done.stderr


def test_courts_are_checked_by_their_name():
    done = run("layouts", "court", "--check", "20", extensions=NAMES)
    assert (done.returncode, done.stdout) == (0, "court: 20 keys, 0 problems\n")
