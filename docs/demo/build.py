"""Builds what the demo loads: lots, the policy `anywhere`, and three npm packages.

python docs/demo/build.py     # needs npm; writes docs/demo/built, then: mkdocs build
"""

import dataclasses
import functools
import json
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_formats.onnx.car import Rows, plain_values
from carpark_formats.onnx.export import environment_rows
from carpark_formats.onnx.models import inputs_of, make_car_model
from carpark_mj.config import PARKED_RULES, EnvConfig, FleetConfig, SensorConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import boxes_overlap
from carpark_mj.mdp.parked_cars import fits
from carpark_mj.policy.loading import load_policy
from carpark_mj.scene.build import drivable_scene, scene_xml
from carpark_mj.spawning.config import RandomizationConfig
from carpark_mj.types import State

HERE = Path(__file__).parent
POLICY = "anywhere"
CARS = ("compact", "city", "van")  # that `anywhere` has driven, the first one first
DRAWS = 12  # of starts for cars that begin again, a start for each car of a draw
MARGIN = 0.4  # m between a start and parked cars
PEOPLE = 6  # pedestrians of a lot, discs for the policy
MODULES = {
    "mujoco": ("@mujoco/mujoco", "mujoco.js", "mujoco.wasm"),
    "onnxruntime": (
        "onnxruntime-web",
        "dist/ort.wasm.bundle.min.mjs",
        "dist/ort-wasm-simd-threaded.wasm",
    ),
    "three": (
        "three",
        "build/three.module.js",
        "build/three.core.js",
        "examples/jsm/controls/OrbitControls.js",
        "LICENSE",
    ),
}


@dataclasses.dataclass(frozen=True)
class Lot:
    """A lot of the demo.

    Attributes:
        title: what the page calls it.
        layout: its family.
        agents: cars that drive, the visitor's among them.
        parked: parked cars.
        seed: of the lot.
    """

    title: str
    layout: str
    agents: int
    parked: int
    seed: int


LOTS = {
    "angled": Lot("Angled bays, three others", "angled", 4, 8, 0),
    "lot": Lot("Car park, four others", "lot", 5, 12, 0),
    "square": Lot("Square, seven others", "square", 8, 16, 0),
    "street": Lot("Street, three others", "street_parallel", 4, 8, 0),
}


@functools.cache
def begin(lot: Lot, car: str = CARS[0]) -> tuple[ParkingEnv, State, np.ndarray]:
    """A lot as an episode begins in it, and poses (starts, 3) to begin again at."""
    env = ParkingEnv(lot_config(lot, car))
    key, *keys = jax.random.split(jax.random.key(lot.seed), 2 + DRAWS)
    layout = env.draw_layout(key)
    reset = jax.jit(jax.vmap(lambda key: env.reset_to_layout(layout, key)[0]))
    states = reset(jax.numpy.stack(keys))
    state = jax.tree.map(lambda x: x[0], states)
    starts = states.motion.pose_w[1:].reshape(-1, 3)
    size = state.motion.size[0] + MARGIN
    parked = state.parked_cars
    near = boxes_overlap(starts[:, None], size, parked.pose_w, parked.size)
    clear = ~(near & parked.present).any(axis=1)
    return env, state, np.asarray(starts)[np.asarray(clear)]


def lot_config(lot: Lot, car: str = CARS[0]) -> EnvConfig:
    """The policy's environment with the cars of a lot, all alike and without noise."""
    return dataclasses.replace(
        load_policy(POLICY).env,
        layout=lot.layout,
        vehicle=car,
        num_agents=lot.agents,
        min_agents=None,
        num_parked_cars=lot.parked,
        occupancy=None,
        fleet=FleetConfig(),
        sensors=SensorConfig(),
        randomization=RandomizationConfig(),
    )


def model_rows() -> Rows:
    """The numbers of rows of the model's inputs: the policy's, and a disc a person."""
    return environment_rows(load_policy(POLICY).env, {"discs": PEOPLE})


def describe(
    lot: Lot, kind: str, rows: Rows, read: Iterable[str]
) -> tuple[dict[str, Any], str]:
    """What the page knows of a lot with cars of a kind, and its scene as MJCF.

    `inputs` are the constant ones of the model, without rows of other cars.
    """
    env, state, starts = begin(lot, kind)
    layout, car = state.layout, env.vehicle
    bays = np.flatnonzero(np.asarray(layout.bay_mask))
    own = state.motion.size[0]
    usable = layout.goal_mask & fits(layout.bay_size, own, env.config.episode.slack)
    known = {name: value[0] for name, value in plain_values(rows, state).items()}
    moving = ("pose", "speed", "yaw_rate", "steering", "goal", "other")
    constant = {n: known[n] for n in read if not n.startswith(moving)}
    motion, parked = state.motion.pose_w, state.parked_cars
    scene = drivable_scene(
        layout, car, np.asarray(motion), np.asarray(parked.pose_w)[parked.present]
    )
    about = {
        "inputs": constant,
        "bay_pose": np.asarray(layout.bay_pose)[bays],
        "bay_size": np.asarray(layout.bay_size)[bays],
        "bay_usable": np.asarray(usable)[bays],
        "start": motion,
        "goal": np.searchsorted(bays, state.goal),
        "starts": starts,
        "extent": layout.extent,
    }
    return about, for_older_mujoco(scene_xml(scene, car))


def for_older_mujoco(xml: str) -> str:
    """A scene for MuJoCo 3.14, the newest that browsers have, its parked cars fixed.

    It knows neither `castshadow`, a matter of looks, nor `input` of a position servo,
    whose input is a position anyway.
    """
    root = ET.fromstring(xml)
    for element in root.iter():
        for name in ("castshadow", "input"):
            element.attrib.pop(name, None)
        if element.tag == "body" and element.get("name", "").startswith("parked"):
            for joint in element.findall("joint"):
                element.remove(joint)
    return ET.tostring(root, encoding="unicode")


def export(out: Path, lots: Iterable[str] = LOTS, cars: Iterable[str] = CARS) -> None:
    """Writes the policy, some lots and what else the page reads into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    loaded = load_policy(POLICY)
    rows = model_rows()
    model = make_car_model(loaded, rows)
    (out / "policy.onnx").write_bytes(model.SerializeToString())
    read = {entry.name: entry for entry in inputs_of(model)}
    described = {}
    for name in lots:
        described[name] = {"title": LOTS[name].title, "cars": {}}
        for car in cars:
            about, xml = describe(LOTS[name], car, rows, read)
            described[name]["cars"][car] = about
            (out / f"{name}-{car}.xml").write_text(xml)
            print(f"{name}, {car}: {len(about['starts'])} starts", flush=True)
    rule = PARKED_RULES[loaded.env.episode.parked_rule]
    assert rule.inside_lines  # the page knows this and these limits
    control = loaded.env.sim.ctrl_dt
    about = {
        "lots": described,
        "inputs": {n: [entry.dtype, *entry.shape(rows)] for n, entry in read.items()},
        "decision_time": control,
        "people": PEOPLE,
        "timeout": loaded.env.episode.max_steps * control,
        "rule": {"heading": rule.heading, "speed": rule.speed},
    }
    text = json.dumps(about, default=lambda array: np.asarray(array).tolist())
    (out / "demo.json").write_text(text)


def vendor(out: Path) -> None:
    """Installs the npm packages and copies what browsers need of them.

    Raises:
        CalledProcessError: npm fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(HERE / "package.json", folder)
        flags = ("--ignore-scripts", "--no-package-lock", "--no-audit", "--no-fund")
        subprocess.run(["npm", "install", "--silent", *flags], cwd=folder, check=True)
        for name, (package, *files) in MODULES.items():
            (out / name).mkdir(parents=True, exist_ok=True)
            for file in files:
                shutil.copy(Path(folder, "node_modules", package, file), out / name)
    for name in ("mujoco", "onnxruntime"):  # their npm packages have no licence files
        for file in metadata.files(name) or ():
            if file.name.startswith(("LICENSE", "ThirdPartyNotices")):
                target = out / name / f"{file.stem}.txt"  # a .md would be a page
                shutil.copy(str(file.locate()), target)


if __name__ == "__main__":
    if shutil.which("npm") is None:
        print(f"{sys.argv[0]}: npm is missing: install Node.js", file=sys.stderr)
        sys.exit(2)
    try:
        vendor(HERE / "built")
    except subprocess.CalledProcessError as error:
        print(f"{sys.argv[0]}: {error}", file=sys.stderr)
        sys.exit(2)
    export(HERE / "built")
