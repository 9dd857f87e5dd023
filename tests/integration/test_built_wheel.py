"""The wheel alone, in a process outside the checkout: it is the whole product."""

import importlib.metadata
import subprocess
import sys
import zipfile

import pytest
from helpers.programs import ROOT, python

pytest.importorskip("hatchling")

pytestmark = pytest.mark.slow

USE = """
import sys
from pathlib import Path

import carpark_mj

wheel = Path(sys.argv[1])
assert Path(carpark_mj.__file__).is_relative_to(wheel), carpark_mj.__file__

import dataclasses

from carpark_mj.cli.driver import ExportConfig, export
from carpark_mj.cli.layouts import LayoutsConfig
from carpark_mj.cli.layouts import main as look
from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training import PPOConfig, evaluate, render, train

config = PPOConfig(
    num_steps=64,
    num_lots=4,
    unroll_length=4,
    num_minibatches=2,
    networks=NetworkConfig((8,), (8,)),
    env=EnvConfig(physics="bicycle", num_parked_cars=2),
)
updates = []
run = train(config, callback=lambda metrics: updates.append(metrics["update"]))
assert updates == [1, 2], updates
assert evaluate(run, episodes=4).summary
assert render(run, "frame.png", frame=0.0, width=320, height=240).stat().st_size
assert export(ExportConfig(str(run.folder), out="policy.npz")).exists()
assert not look(LayoutsConfig(("square",), check=1))  # the exit code
homes = {name: m.__file__ for name, m in sys.modules.items() if "carpark_mj" in name}
for name, file in homes.items():
    assert Path(file).is_relative_to(wheel), (name, file)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The folder that the wheel installs."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d"]
    subprocess.run([*build, str(folder)], cwd=ROOT, check=True, capture_output=True)
    [file] = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "installed")
    return folder / "installed"


def test_it_trains_evaluates_renders_exports_and_checks_layouts(wheel, tmp_path):
    done = python("-c", USE, wheel, cwd=tmp_path, PYTHONPATH=str(wheel))
    assert done.returncode == 0, done.stderr


def test_its_command_lists_the_programs(wheel, tmp_path):
    [found] = importlib.metadata.distributions(path=[str(wheel)])
    [command] = found.entry_points.select(group="console_scripts")
    assert (command.name, command.value) == ("carpark_mj", "carpark_mj.__main__:main")
    flags = "-m", "carpark_mj", "--help"
    done = python(*flags, cwd=tmp_path, PYTHONPATH=str(wheel))
    assert done.returncode == 0, done.stderr
    for name in ("train", "evaluate", "render", "scene", "play", "layouts", "suite"):
        assert f"\n  {name} " in done.stdout


def test_the_page_of_the_editor_is_there(wheel):
    page = "carpark_mj/editor/page"
    there, here = ({f.name for f in (at / page).iterdir()} for at in (wheel, ROOT))
    assert there == here
