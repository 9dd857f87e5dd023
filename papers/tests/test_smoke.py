"""A short run of every program of the papers, as CI makes it for every change."""

import ast
from pathlib import Path

import jax
import pytest
from helpers.programs import exit_code

from carpark_mj.env import ParkingEnv
from carpark_mj.programs import STUDY_PROGRAMS
from carpark_mj.registry import environment

pytestmark = pytest.mark.smoke
JUNCTIONS = ("--junctions", "2", "--steps", "2", "--repeats", "1")
# What each needs beside the package's own dependencies, and flags of a short run.
RUNS = {
    "tanner": ((), ("--list",)),
    "slots": ((), ("--list",)),
    "junction_tables": ((), ("--list",)),
    "q_learning": ((), ("--episodes", "3", "--num-seeds", "2", "--eval-episodes", "1")),
    "junction_scene": ((), ("--out", "junction.xml")),
    "junction_speed": ((), ("--cars", "path", "--observations", "vector", *JUNCTIONS)),
    "sac": (
        ("sbx",),
        (
            *("--phases", "slots:200", "--num-cars", "4", "--random-steps", "80"),
            *("--eval-episodes", "2", "--video-seconds", "0"),
        ),
    ),
    "junction": (
        ("rlax", "flashbax"),
        (
            *("--num-junctions", "4", "--total-steps", "400", "--eval-period", "200"),
            *("--random-steps", "80", "--eval-episodes", "2", "--video-episodes", "0"),
        ),
    ),
}


def test_every_program_has_a_short_run():
    assert {*RUNS} <= {*STUDY_PROGRAMS}


def test_only_public_names_of_the_core_are_imported():
    for path in (Path(__file__).parents[1] / "carpark_papers").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                names = [*str(node.module).split("."), *(x.name for x in node.names)]
                assert not [name for name in names if name.startswith("_")], path


@pytest.mark.parametrize("name", RUNS)
def test_a_program_runs(name, tmp_path, monkeypatch):
    needed, flags = RUNS[name]
    for package in needed:
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    assert exit_code("study", [name, *flags]) == 0


@pytest.mark.parametrize(
    "name",
    [
        *("tanner-fixed", "tanner-dynamic", "tanner-qlearning", "pandita", "slots"),
        *("tanner-qlearning-recorded", "tanner-qlearning-rings"),
    ],
)
def test_an_environment_is_found_and_traced(name):
    env = ParkingEnv(environment(name))
    state, observation = jax.eval_shape(env.reset, jax.random.key(0))
    spec = env.action_spec
    action = jax.ShapeDtypeStruct((env.num_agents, spec.size), spec.dtype)
    _, timestep = jax.eval_shape(env.step, state, action)
    assert timestep.observation.shape == observation.shape
