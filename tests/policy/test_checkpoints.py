"""Checkpoints and configs: exact round trips, whole files only, or one clear line."""

import dataclasses
import json
import signal
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.mutating import with_junk
from helpers.trees import same

from carpark_mj.policy import checkpoints, loading, runs
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS

# Writes a checkpoint, and is killed before the file has its name.
KILLED = """
import os, pathlib, sys
from carpark_mj.policy import runs
os.fsync = lambda file: os.kill(os.getpid(), 9)
runs.save_checkpoint(pathlib.Path(sys.argv[1]), {}, {}, 10)
"""


def tree():
    return {
        "weights": {"kernel": jax.random.normal(jax.random.key(3), (4, 5))},
        "count": jnp.array(7, jnp.int32),
        "keys": jax.random.split(jax.random.key(1), 3),
        "flags": jnp.array([True, False]),
    }


def test_a_round_trip_is_exact_and_keeps_keys_and_header(tmp_path):
    path = tmp_path / "a.npz"
    checkpoints.save(path, tree(), {"steps": 12})
    loaded = checkpoints.load(path, jax.eval_shape(tree))
    assert same(loaded, tree())
    draws = [jax.random.uniform(t["keys"][2]) for t in (loaded, tree())]
    assert draws[0] == draws[1]
    assert checkpoints.read_header(path)["steps"] == 12
    part = {"weights": tree()["weights"]}  # can be read alone
    assert same(checkpoints.load(path, part), part)
    with np.load(path, allow_pickle=False) as file:
        assert {file[name].dtype.kind for name in file.files} <= set("fiub")


@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.98])
def test_a_truncated_checkpoint_is_one_clear_error(tmp_path, kept):
    path = tmp_path / "a.npz"
    checkpoints.save(path, tree(), {})
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data)) if kept < 1 else kept])
    with pytest.raises(CheckpointError) as caught:
        checkpoints.load(path, tree())
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_foreign_files_are_refused_by_name(tmp_path):
    text, archive, array = (tmp_path / n for n in ("a.txt", "b.npz", "c.npy"))
    text.write_text("hello")
    np.savez(archive, x=np.zeros(3))
    np.save(array, np.zeros(3))
    for path in (text, archive, array, tmp_path / "missing.npz"):
        with pytest.raises(CheckpointError, match=path.name):
            checkpoints.read_header(path)


def test_misfits_name_the_array_and_both_shapes(tmp_path):
    path = tmp_path / "a.npz"
    checkpoints.save(path, tree(), {})
    with pytest.raises(CheckpointError, match=r"kernel.*\[4, 5\].*\[4, 6\]"):
        checkpoints.load(path, {"weights": {"kernel": jnp.zeros((4, 6))}})
    with pytest.raises(CheckpointError, match=r"lacks.*bias"):
        checkpoints.load(path, {"weights": {"bias": jnp.zeros(5)}})


def test_the_last_two_checkpoints_are_kept_and_no_abandoned_one(tmp_path):
    paths = [runs.save_checkpoint(tmp_path, {}, {}, step) for step in (10, 200, 3000)]
    assert paths[2].name == "step_000000003000.npz"
    assert runs.checkpoint_files(tmp_path) == paths[1:]
    newest = runs.save_checkpoint(tmp_path, {}, {}, 1500)  # the run went back
    assert runs.checkpoint_files(tmp_path) == [paths[1], newest]
    assert runs.latest_checkpoint(tmp_path) == newest


def test_what_a_killed_process_has_left_is_no_checkpoint(tmp_path):
    killed = subprocess.run([sys.executable, "-c", KILLED, tmp_path], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert len([*(tmp_path / "checkpoints").iterdir()]) == 1
    assert runs.checkpoint_files(tmp_path) == []
    path = runs.save_checkpoint(tmp_path, tree(), {}, 20)
    assert runs.checkpoint_files(tmp_path) == [path]


def test_the_newest_readable_checkpoint_is_found(tmp_path):
    for folder, said in ((tmp_path, "holds no checkpoint"), (tmp_path / "x", "x")):
        with pytest.raises(CheckpointError, match=said):
            runs.latest_checkpoint(folder)
    for step in (1, 2):
        newest = runs.save_checkpoint(tmp_path, tree(), {"step": step}, step)
    newest.write_bytes(b"PK half")
    path = runs.latest_checkpoint(tmp_path)
    assert checkpoints.read_header(path)["step"] == 1
    path.write_bytes(b"")
    with pytest.raises(CheckpointError, match=newest.name):
        runs.latest_checkpoint(tmp_path)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_config_survives_json(name):
    config = dataclasses.replace(PRESETS[name], seed=5, learning_rate=1e-3)
    text = json.dumps(dataclasses.asdict(config))
    assert runs.from_dict(PPOConfig, json.loads(text)) == config


@dataclasses.dataclass(frozen=True)
class Eye:
    reach: float = 1.0


@dataclasses.dataclass(frozen=True)
class Seeing:
    eye: Eye = dataclasses.field(default_factory=Eye)
    other: Eye | None = None


@pytest.mark.parametrize("other", [None, Eye(2.0)])
def test_a_config_inside_a_config_or_none_survives_json(other):
    text = json.dumps(dataclasses.asdict(Seeing(Eye(3.0), other)))
    assert runs.from_dict(Seeing, json.loads(text)) == Seeing(Eye(3.0), other)


def test_an_older_checkpoint_is_refused_before_it_is_read(tmp_path):
    header = {"config": {"env": {"gone": 1}}, "env_steps": 8}
    path = runs.save_checkpoint(tmp_path / "x", {"a": np.zeros(1)}, header, 8)
    for run in (tmp_path / "x", path):
        with pytest.raises(CheckpointError, match="unusable config"):  # not its age
            loading.load_policy(run)
    checkpoints.save(path, {"a": np.zeros(1)}, header)
    for run in (tmp_path / "x", path):
        with pytest.raises(CheckpointError, match=r"is of another carpark"):
            loading.load_policy(run)


@pytest.mark.parametrize("preset", ["anywhere", "dynamic"])
def test_settings_with_junk_are_a_config_or_refused(preset):
    data = dataclasses.asdict(PRESETS[preset])
    for seed in range(300):
        try:
            config = runs.from_dict(PPOConfig, with_junk(data, seed))
        except ValueError:
            continue
        hash(config)  # so nowhere a list or a dictionary
        again = json.loads(json.dumps(dataclasses.asdict(config)))
        assert runs.from_dict(PPOConfig, again) == config
