"""The examples: PPO in one file runs, the FMU drives, bad input is one line."""

import importlib
import re
import subprocess
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import ROOT, python

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv

EXAMPLES = ROOT / "examples"


@pytest.mark.slow
def test_ppo_in_one_file_trains_and_evaluates(tmp_path):
    pytest.importorskip("torch")
    flags = ("--minutes", "0.05", "--lots", "8", "--minibatches", "4")
    ended = python(EXAMPLES / "cleanrl_ppo.py", *flags, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert re.search(r"held out: [\d.]+% of 1024 episodes parked", ended.stdout)


def test_ppo_in_one_file_learns_from_pictures(monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(EXAMPLES)
    ppo = importlib.import_module("cleanrl_ppo")

    def steps(*shape):
        return torch.rand(8, 2, 3, *shape)

    pictures = (255 * steps(2, 36, 40)).to(torch.uint8)
    data = {name: steps() for name in ("log_prob", "reward", "advantage", "target")}
    data |= {"observation": {"vector": steps(5), "camera_seen": pictures}}
    agent = ppo.Agent(data["observation"], 2)
    before = agent.eye[0].weight.clone()
    assert agent.value(data["observation"]).shape == (8, 2, 3)
    optimizer = torch.optim.Adam(agent.parameters())
    ppo.update(ppo.Settings(), agent, optimizer, data | {"action": steps(2)})
    assert (agent.eye[0].weight != before).any()


def test_cloning_takes_the_mean_action_and_iql_a_better_one(monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.syspath_prepend(EXAMPLES)
    offline = importlib.import_module("offline")
    torch.manual_seed(0)
    seen = torch.rand(2000, 3)
    action = (torch.rand(2000, 1) < 0.5).float()  # 1 is better everywhere
    reward = action[:, 0] + seen[:, 0]
    names = (seen, seen, action, reward, torch.ones(2000))
    rows = dict(zip(offline.ROWS, names, strict=True))
    mean = {}
    for method in ("bc", "iql"):
        settings = offline.Settings(method=method, steps=400)
        mean[method] = offline.learn(settings, rows)(seen).mean().item()
    assert mean["bc"] == pytest.approx(action.mean().item(), abs=0.1)
    assert mean["iql"] > 0.75


def test_a_bad_flag_of_an_example_is_one_line(tmp_path):
    pytest.importorskip("torch")
    ended = python(EXAMPLES / "cleanrl_ppo.py", "--out", "no/a.png", cwd=tmp_path)
    said = "cleanrl_ppo: cannot use no/a.png: No such file or directory\n"
    assert (ended.returncode, ended.stderr) == (2, said)


def test_what_is_no_scene_to_drive_is_one_line(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text("<mujoco/>")
    ended = python("-I", EXAMPLES / "drive_scene.py", path)
    assert ended.returncode == 2
    said = r"Invalid name 'agent0/car'\. .*"
    assert re.fullmatch(rf".*drive_scene\.py: {path}: {said}\n", ended.stderr)


def test_a_search_learns_from_its_trials_and_ends_bad_ones(tmp_path, monkeypatch):
    pytest.importorskip("optuna")
    monkeypatch.syspath_prepend(EXAMPLES)
    search = importlib.import_module("optuna_search")
    asked = []

    def train(config, callback):
        asked.append(config)
        quality = 0.1 if len(asked) == 5 else 0.8  # the fifth is worse
        for part in range(20):
            if callback({"progress": part / 20, "episode/parked": quality * part / 20}):
                return SimpleNamespace(outcome="stopped")
        return SimpleNamespace(outcome="done")

    monkeypatch.setattr(search, "train", train)
    settings = search.Settings(out=tmp_path)
    for _ in range(5):
        search.drive(settings)
    trials = search.open_study(settings).trials
    states = [trial.state.name for trial in trials]
    assert states == ["COMPLETE"] * 4 + ["PRUNED"]
    # The last of ten parts has two updates.
    assert trials[0].value == pytest.approx(0.8 * 18.5 / 20)
    for config, trial in zip(asked, trials, strict=True):
        assert config.learning_rate == trial.params["learning_rate"]
        assert config.discount == 1.0 - trial.params["1 - discount"]


@pytest.mark.slow
def test_planned_paths_are_drawn(tmp_path):
    pytest.importorskip("ompl")
    flags = ("--levels", "extreme", "tpcap", "--cases", "1", "--out", "a.png")
    ended = python(EXAMPLES / "planned_paths.py", *flags, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


SECONDS, PERIOD = 20.0, 0.2


@pytest.mark.slow
def test_an_fmu_drives_as_the_environment_s_car(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    pytest.importorskip("pythonfmu3")
    car = ROOT / "examples" / "fmu" / "car.py"
    build = (sys.executable, "-m", "pythonfmu3", "build", "-f", str(car))
    subprocess.run((*build, "--dest", str(tmp_path)), check=True, capture_output=True)
    begin = np.arange(0.0, SECONDS, PERIOD)
    # To both sides and to and fro, each action held for a control step.
    actions = np.stack([np.sin(0.5 * begin), 0.6 * np.sin(0.3 * begin + 0.5)], axis=1)
    ends = np.stack([begin, begin + PERIOD - 1e-9], axis=1).ravel()
    held = np.column_stack([ends, np.repeat(actions, 2, axis=0)])
    kinds = [("time", float), ("steer", float), ("pedal", float)]
    rows = fmpy.simulate_fmu(
        str(tmp_path / "Car.fmu"),
        stop_time=SECONDS,
        step_size=0.02,
        output_interval=PERIOD / 2,
        input=np.array([*map(tuple, held)], kinds),
        output=["x", "y", "yaw", "speed", "steering", "finite"],
        start_values={"vehicle": "city"},
    )
    config = EnvConfig(vehicle="city", num_agents=1, num_parked_cars=0)
    env = ParkingEnv(config)
    vehicles = env.fleet.of_kind(jnp.zeros(1, jnp.int32))
    state = env.physics.init(jnp.zeros((1, 3)), vehicles)
    step = jax.jit(env.physics.step)
    for action, row in zip(jnp.float32(actions), rows[2::2], strict=True):
        state = step(state, action[None])
        motion = env.physics.read(state)
        expected = [*motion.pose_w[0], motion.speed[0], motion.steering[0]]
        found = [row[name] for name in ("x", "y", "yaw", "speed", "steering")]
        np.testing.assert_allclose(found, expected, atol=1e-4)
        assert row["finite"]
    assert np.ptp(rows["speed"]) > 3.0
    assert np.ptp(rows["yaw"]) > 3.0
