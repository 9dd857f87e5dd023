"""The distribution: its commands, its wheel, and what the pages say of it."""

import ast
import csv
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml
from helpers.pages import PAGES, calls, section
from helpers.programs import ROOT, python, rows_of
from map_texts import openstreetmap, write
from test_docs import check_command, needs_formats

import afternoon
from carpark_formats.onnx.car import INPUTS
from carpark_mj.extensions import FORMATS, Entry
from carpark_mj.layouts.base import LAYOUT_WRITERS
from carpark_mj.policy.named import READERS
from carpark_mj.programs import COMMANDS, find
from carpark_mj.suite.levels import LEVELS

FORMATS_FOLDER = Path(__file__).parents[1]
PAGES = [*PAGES, FORMATS_FOLDER / "README.md"]
LINES = {line for page in PAGES for line in calls(page.read_text())}
HOMES = {
    "command": COMMANDS,
    "level": LEVELS,
    "format to save": LAYOUT_WRITERS,
    "kind of policy": READERS,
}


@pytest.mark.parametrize("line", sorted(filter(needs_formats, LINES)))
def test_a_command_of_the_formats_exists_and_takes_its_flags(line):
    assert find(line.split()[1:3])[0] in COMMANDS
    check_command(line)


def test_what_the_core_says_comes_with_the_package_does():
    for kind, home in HOMES.items():
        for name in FORMATS[kind]:
            assert name in home, (kind, name)
    ours = {n for n, x in COMMANDS.items() if x.home.startswith("carpark_formats.")}
    assert ours == {*FORMATS["command"], "export"}
    for name in FORMATS["command"]:
        assert callable(COMMANDS[name].load())
        assert Entry(COMMANDS[name].settings).load().__doc__


def test_inputs_of_a_model_are_those_of_the_pages():
    with (ROOT / "docs" / "model_inputs.csv").open(newline="") as file:
        found = list(csv.reader(file))
    expected = [["input", "shape", "unit", "meaning"]]
    for entry in INPUTS:
        shape = ", ".join(map(str, entry.dims)) + "," * (len(entry.dims) == 1)
        unit = entry.unit or entry.dtype
        expected.append([entry.name, f"({shape})", unit, entry.meaning])
    assert found == expected
    page = (ROOT / "docs" / "deployment.md").read_text()
    named = re.findall(r"`(\w+)`", section(page, "inputs of a car"))
    assert named == [entry.name for entry in INPUTS]


def test_only_public_names_of_the_core_are_imported():
    for path in (FORMATS_FOLDER / "carpark_formats").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and "carpark_mj" in str(node.module):
                assert not [x for x in node.names if x.name.startswith("_")], path


# Modules that a help or a refusal does without.
USED = """
import contextlib, io, sys
from carpark_mj.programs import COMMANDS, run

for name in sys.argv[1:]:
    text = io.StringIO()
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(text):
        run(name, ["--help"])
    assert f"usage: carpark_mj {name}" in text.getvalue(), name
    assert ("--from-state" in text.getvalue()) == (name == "export"), name
    with contextlib.suppress(ValueError):
        raise AssertionError(run(name, ["--no-such-flag", "1"]))
print(*[x for x in ("jax", "mujoco", "shapely", "ezdxf", "onnx") if x in sys.modules])
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The folder that the wheel installs."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d"]
    build.append(str(folder))
    subprocess.run(build, cwd=FORMATS_FOLDER, check=True, capture_output=True)
    [file] = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        archive.extractall(folder / "installed")
    return folder / "installed"


def test_the_wheel_brings_its_commands_and_helps_without_jax(wheel, tmp_path):
    paths = {"PYTHONPATH": os.pathsep.join([str(wheel), str(ROOT)]), "cwd": tmp_path}
    listed = python("-m", "carpark_mj", **paths)
    assert all(f"\n  {name} " in listed.stdout for name in FORMATS["command"])
    helped = python("-c", USED, *FORMATS["command"], "export", **paths)
    assert (helped.returncode, helped.stdout) == (0, "\n"), helped.stderr
    write(tmp_path, "lot.osm", openstreetmap())
    words = "-m", "carpark_mj", "layouts", "import", "lot.osm", "--out", "lot.json"
    done = python(*words, **paths)
    assert done.returncode == 0, done.stderr
    saved = "-m", "carpark_mj", "layouts", "lot.json", "--save", "lot.xodr"
    assert python(*saved, **paths).returncode == 0
    assert "parkingSpace" in (tmp_path / "lot.xodr").read_text()


@pytest.mark.slow
def test_an_afternoon_goes_from_a_map_to_a_report(tmp_path):
    flags = ["--repetitions", "2", "--out", str(tmp_path / "day")]
    assert afternoon.main(flags) == 0
    text = (tmp_path / "day" / "report.html").read_text()
    assert "child.yaml:2" in text
    settings = yaml.safe_load((tmp_path / "day" / "child.yaml").read_text())["settings"]
    for name, value in settings.items():
        true = getattr(afternoon.TRUE, name.removeprefix("sim."))
        assert value == pytest.approx(true, abs=0.05), name
    assert len(settings) == 2
    minutes = [float(row["minutes"]) for row in rows_of(tmp_path / "day/minutes.csv")]
    assert len(minutes) == len(afternoon.STEPS) + 1
    assert minutes[-1] == pytest.approx(sum(minutes[:-1]))
