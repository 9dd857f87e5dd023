"""A back end of another package, as a user of it has it."""

import json

import pytest
from helpers.packages import run, train

pytestmark = pytest.mark.slow

NAMES = ("hover",)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates of craft that hover."""
    flags = ("--env.physics", "hover")
    return train(*flags, extensions=NAMES, runs=tmp_path_factory.mktemp("runs"))


def test_ppo_trains_on_it_and_the_policy_is_read_back(trained, tmp_path):
    flags = ("--episodes", "8", "--out", str(tmp_path / "found"))
    done = run("evaluate", str(trained), *flags, extensions=NAMES)
    assert done.returncode == 0, done.stderr
    assert "hover physics" in done.stdout
    assert json.loads((tmp_path / "found" / "evaluation.json").read_text())


@pytest.mark.parametrize(
    ("extensions", "flags", "named"),
    [
        (NAMES, ("--physics", "mjx"), "other actions"),
        ((), (), "unknown physics 'hover'"),
    ],
)
def test_elsewhere_the_policy_is_refused_in_one_line(trained, extensions, flags, named):
    done = run("evaluate", str(trained), *flags, extensions=extensions)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert named in done.stderr
