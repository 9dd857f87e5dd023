"""`carpark_mj train` and `carpark_mj study` with parts of another package."""

import os
import re

import pytest
from helpers.programs import ROOT, python

from carpark_mj.training import Run

pytestmark = pytest.mark.slow

MODULE = """
from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS
from carpark_mj.training.ppo.parts import PRESETS, VARIANTS

PRESETS.register("tiny", Entry("tiny_parts:TINY", "of another package"))
VARIANTS.register("halved", Entry("tiny_parts:HALVED"))
STUDY_PROGRAMS.register("hello", Entry("tiny_parts:hello", "greet"))
"""
PARTS = """
import jax

from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training import PPOConfig
from carpark_mj.training.ppo.variants import Variant


class Halved(Variant):
    def loss(self, *arguments):
        loss, said = super().loss(*arguments)
        return loss / 2, said | {"halved": loss / 2}


HALVED = Halved()
TINY = PPOConfig(
    preset="tiny",
    num_steps=64,
    num_lots=4,
    unroll_length=4,
    num_minibatches=2,
    variant="halved",
    eval_episodes=0,
    video_seconds=0.0,
    networks=NetworkConfig((8,), (8,)),
    env=EnvConfig(physics="bicycle", num_parked_cars=2),
)


def hello(arguments):
    print("hello", *arguments)
"""
METADATA = "Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n"


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A folder with the package's modules."""
    folder = tmp_path_factory.mktemp("package")
    (folder / "tiny_extension.py").write_text(MODULE)
    (folder / "tiny_parts.py").write_text(PARTS)
    return folder


@pytest.fixture(scope="module")
def installed(package):
    """The same as pip leaves it: it names its module as an entry point."""
    metadata = package / "tiny-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(METADATA)
    (metadata / "entry_points.txt").write_text(
        "[carpark_mj.extensions]\ntiny = tiny_extension\n"
    )
    return package


def command(package, *arguments, **environment):
    path = os.pathsep.join([str(ROOT), str(package)])
    return python("-m", "carpark_mj", *arguments, PYTHONPATH=path, **environment)


def test_a_named_module_s_preset_and_variant_train(package, tmp_path):
    flags = ("--preset", "tiny", "--runs-dir", str(tmp_path), "--name", "tiny")
    done = command(package, "train", *flags, CARPARK_MJ_EXTENSIONS="tiny_extension")
    assert done.returncode == 0, done.stderr
    rows = Run(tmp_path / "tiny").metrics
    assert [row["update"] for row in rows] == [1, 2]
    for row in rows:
        assert row["loss/halved"] == pytest.approx(row["loss/total_loss"] / 2)


def test_an_installed_package_is_listed_and_runs(installed):
    done = command(installed, "study", "hello", "you")
    assert (done.stdout, done.stderr) == ("hello you\n", "")
    assert "\n  hello " in command(installed, "study").stdout
    assert "of another package, " in command(installed, "train", "--help").stdout


def test_without_it_they_are_unknown(tmp_path):
    for arguments, said in (
        (("train", "--preset", "tiny"), "unknown preset 'tiny'; choose from"),
        (("study", "hello"), "no program is installed|unknown program 'hello'"),
    ):
        done = command(tmp_path, *arguments)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert re.search(said, done.stderr)
