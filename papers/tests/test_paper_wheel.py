"""The wheel of the papers: its data are in it, and the command finds its programs."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from helpers.programs import python

PAPERS = Path(__file__).parents[1]
PROGRAMS = (
    *("junction", "junction_scene", "junction_speed", "junction_tables"),
    *("q_learning", "sac", "slots", "tanner"),
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The folder that the wheel installs."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d"]
    subprocess.run([*build, str(folder)], cwd=PAPERS, check=True, capture_output=True)
    [file] = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "installed")
    return folder / "installed"


def test_the_command_lists_the_programs_of_the_wheel(wheel, tmp_path):
    paths = os.pathsep.join([str(wheel), str(PAPERS.parent)])
    done = python("-m", "carpark_mj", "study", cwd=tmp_path, PYTHONPATH=paths)
    assert done.returncode == 0, done.stderr
    assert all(f"\n  {name} " in done.stdout for name in PROGRAMS)


def test_tables_of_published_numbers_are_in_the_wheel(wheel):
    files = {path.name for path in wheel.rglob("*.csv")}
    assert files >= {"tanner_2022.csv", "cederle_2023.csv"}
