"""The examples of deployment: without JAX, in Python and in C++."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from helpers.programs import ROOT, python

from carpark_formats.onnx.export import environment_rows
from carpark_formats.onnx.models import make_car_model, make_session
from carpark_mj.cli.scene import SceneConfig, make_scene
from carpark_mj.policy.loading import load_policy
from carpark_mj.scene.build import scene_xml
from carpark_mj.vehicle import preset

pytestmark = pytest.mark.slow
DEPLOY = ROOT / "examples" / "deploy"
SEEDS = 4
HEADER = "onnxruntime_cxx_api.h"
# Where to look for it; the variable names a folder of one's own.
INCLUDES = (
    os.environ.get("ONNXRUNTIME_INCLUDE", ""),
    "/usr/include/onnxruntime",
    "/usr/local/include/onnxruntime",
)
DRIVES = """
import json, sys
sys.path.insert(0, sys.argv[1])
from drive import park
print(json.dumps([park(scene, sys.argv[2]) for scene in sys.argv[3:]]))
assert not {"jax", "carpark_mj"} & sys.modules.keys()
"""


@pytest.fixture(scope="module")
def model():
    loaded = load_policy("square")
    return make_car_model(loaded, environment_rows(loaded.env, {}))


@pytest.fixture(scope="module")
def model_file(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("deploy") / "car.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def test_the_example_parks_a_car_of_the_square_without_jax(model_file, tmp_path):
    scenes = []
    for seed in range(SEEDS):
        config = SceneConfig(out="scene.xml", num_agents=1, seed=seed)
        scenes.append(tmp_path / f"{seed}.xml")
        scenes[-1].write_text(scene_xml(make_scene(config)[0], preset("compact")))
    ended = python("-c", DRIVES, DEPLOY, model_file, *scenes, PYTHONPATH=None)
    assert ended.returncode == 0, ended.stderr
    drives = re.findall(r'"metres": ([\d.]+), "sine": ([\d.e-]+)', ended.stdout)
    parked = [float(gap) < 0.2 and float(sine) < 0.06 for gap, sine in drives]
    assert len(parked) == SEEDS
    assert sum(parked) >= SEEDS - 1


def build(folder):
    """The program in C++, or why there is none."""
    compiler = shutil.which("g++") or shutil.which("c++")
    found = [path for path in INCLUDES if path and Path(path, HEADER).exists()]
    libraries = list(Path(onnxruntime.__file__).parent.glob("capi/libonnxruntime.so.*"))
    if compiler is None or not found or not libraries:
        pytest.skip(f"needs a C++ compiler, {HEADER} (ONNXRUNTIME_INCLUDE), a library")
    (folder / "libonnxruntime.so.1").symlink_to(libraries[0])
    program = folder / "decide"
    source = [DEPLOY / "decide.cpp", "-I", found[0], libraries[0]]
    flags = ["-std=c++17", "-O2", "-Wall", "-Werror", f"-Wl,-rpath,{folder}"]
    subprocess.run([compiler, *source, *flags, "-o", program], check=True)
    return program


def test_the_program_in_cpp_decides_as_python_does(model, model_file, tmp_path):
    program = build(tmp_path)
    session, random = make_session(model), np.random.default_rng(0)
    known = {
        value.name: random.random(value.shape) > 0.5
        if value.type == "tensor(bool)"
        else random.uniform(1.0, 8.0, value.shape).astype(np.float32)
        for value in session.get_inputs()
    }
    known = {name: np.asarray(value) for name, value in known.items()}
    lines = [
        " ".join([name, *(f"{x:.9g}" for x in np.ravel(value).astype(float))])
        for name, value in known.items()
    ]
    ended = subprocess.run(
        [program, model_file],
        input="\n".join(lines),
        capture_output=True,
        text=True,
        check=True,
    )
    action, time = ended.stdout.splitlines()
    expected = session.run(None, known)[0]
    np.testing.assert_allclose(np.fromstring(action, sep=" "), expected, atol=1e-6)
    assert re.fullmatch(r"[\d.]+ ms a decision", time)
    bad = subprocess.run([program], capture_output=True, text=True, check=False)
    assert bad.returncode == 2
    assert bad.stderr.startswith("usage: ")
