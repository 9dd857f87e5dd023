"""`train/ppo.py` and `train/sweep.py` as a user runs them: runs, kills, errors."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.programs import ROOT, assert_refused, python, rows_of

from carpark_mj.cli import evaluate

pytestmark = pytest.mark.slow

TINY = (
    *("--preset", "cpu", "--num-lots", "4", "--num-minibatches", "2"),
    *("--unroll-length", "4", "--num-steps", "640", "--checkpoint-minutes", "1e-6"),
    *("--minutes", "0"),  # repeatable
    *("--env.num-parked-cars", "4", "--env.sim.sim-dt", "0.02"),
    *("--env.physics", "bicycle"),  # quicker to compile; `test_learner` trains on MJX
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
    *("--eval-episodes", "0", "--video-seconds", "0"),
)
UPDATES = 20  # 640 steps / (4 lots x 2 agents x 4 control steps)


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """A compilation cache of their own, so that restarts are quick; two devices."""
    cache = str(tmp_path_factory.mktemp("cache"))
    given = {"COLUMNS": "200", "JAX_NUM_CPU_DEVICES": "2"}
    return given | {"JAX_COMPILATION_CACHE_DIR": cache}


def run(environment, script, *arguments):
    return python(ROOT / script, *arguments, **environment)


def begin(environment, *arguments, script="train/ppo.py"):
    """A training that goes on."""
    return subprocess.Popen(
        [sys.executable, str(ROOT / script), *arguments],
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_rows(process, folder, rows):
    """Until the run has logged more updates than that."""
    path, deadline = folder / "metrics.csv", time.monotonic() + 300
    while time.monotonic() < deadline and process.poll() is None:
        if path.exists() and path.read_text().count("\n") > rows:
            break
        time.sleep(0.002)


def metrics(folder):
    return rows_of(folder / "metrics.csv")


def checkpoint(folder):
    return sorted((folder / "checkpoints").glob("*.npz"))[-1]


@pytest.fixture(scope="module")
def finished(environment, tmp_path_factory):
    """An undisturbed tiny run."""
    runs = tmp_path_factory.mktemp("runs")
    start = (*TINY, "--runs-dir", str(runs), "--name", "whole")
    done = run(environment, "train/ppo.py", *start)
    assert done.returncode == 0, done.stderr
    return runs / "whole", done


def test_a_run_leaves_everything_it_promises(finished):
    folder, done = finished
    names = {path.name for path in folder.iterdir()}
    assert names == {
        ".lock",
        "checkpoints",
        "config.json",
        "learning_curve.png",
        "metrics.csv",
        "tensorboard",
    }
    assert len(list((folder / "checkpoints").iterdir())) == 2
    assert (folder / "learning_curve.png").read_bytes()[:4] == b"\x89PNG"
    assert any((folder / "tensorboard").iterdir())
    described = json.loads((folder / "config.json").read_text())
    assert described["config"]["num_lots"] == 4
    assert described["versions"]["mujoco"]
    assert described["config"]["env"]["sim"]["sim_dt"] == 0.02
    assert str(folder) in done.stdout
    rows = metrics(folder)
    assert [int(row["update"]) for row in rows] == list(range(1, UPDATES + 1))
    assert int(rows[-1]["env_steps"]) == 640
    for row in rows:
        assert 0 <= float(row["episode/parked"]) <= 1
        assert np.isfinite([float(value) for value in row.values()]).all()


def test_a_run_killed_twice_ends_like_an_undisturbed_one(finished, environment):
    runs = finished[0].parent
    folder = runs / "killed"
    start = (*TINY, "--runs-dir", str(runs), "--name", "killed")
    for arguments, rows in ((start, 7), (("--resume", str(folder)), 13)):
        process = begin(environment, *arguments)
        wait_for_rows(process, folder, rows)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
    done = run(environment, "train/ppo.py", "--resume", str(folder))
    assert done.returncode == 0, done.stderr

    whole = np.load(checkpoint(finished[0]))
    killed = np.load(checkpoint(folder))
    assert set(whole.files) == set(killed.files)
    for name in whole.files:
        if name != "header":  # it holds the run's name
            np.testing.assert_array_equal(killed[name], whole[name], err_msg=name)
    clock = ("seconds", "steps_per_second")
    for ours, theirs in zip(metrics(folder), metrics(finished[0]), strict=True):
        for name in clock:
            del ours[name], theirs[name]
        assert ours == theirs


def on_two_hosts(environment, *arguments):
    """Trains in two processes with a device each."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        coordinator = f"localhost:{free.getsockname()[1]}"
    flags = ("--coordinator", coordinator, "--num-hosts", "2", "--host")
    one = environment | {"JAX_NUM_CPU_DEVICES": "1"}
    processes = [begin(one, *arguments, *flags, str(host)) for host in range(2)]
    said = [process.communicate(timeout=600) for process in processes]
    return [
        subprocess.CompletedProcess(process.args, process.returncode, *texts)
        for process, texts in zip(processes, said, strict=True)
    ]


def test_two_hosts_train_like_two_devices_of_one(finished, environment):
    folder = finished[0].parent / "hosts"
    before = set(folder.parent.iterdir())
    start = (*TINY, "--runs-dir", str(folder.parent), "--name", "hosts")
    # The limit is reached in the first update, and one host goes on.
    both = on_two_hosts(environment, *start, "--time-limit", "1e-4")
    assert [done.returncode for done in both] == [0, 0], both
    assert f"--resume {folder}" in both[0].stdout
    assert "--resume" not in both[1].stdout  # host 0 speaks for all
    assert set(folder.parent.iterdir()) - before == {folder}
    assert checkpoint(folder).name == "step_000000000032.npz"
    done = run(environment, "train/ppo.py", "--resume", str(folder))
    assert done.returncode == 0, done.stderr
    whole, ours = np.load(checkpoint(finished[0])), np.load(checkpoint(folder))
    assert set(whole.files) == set(ours.files)
    for name in whole.files:
        if name != "header":
            # Sums over devices, here over hosts; measured: no difference.
            np.testing.assert_allclose(ours[name], whole[name], atol=1e-5, err_msg=name)


def test_seeds_side_by_side_are_runs_like_any_other(finished, environment, tmp_path):
    """That a run has the numbers of one alone is seen in `tests/training`."""
    start = (*TINY, "--runs-dir", str(tmp_path), "--name")
    stop = ("--time-limit", "1e-4")  # reached in the first update
    done = run(environment, "train/ppo.py", *start, "group", "--seeds", "0..1", *stop)
    assert done.returncode == 0, done.stderr
    folders = [str(tmp_path / f"group-{seed}") for seed in range(2)]
    assert f"--resume {' '.join(folders)}\n" in done.stdout
    done = run(environment, "train/ppo.py", "--resume", *folders)
    assert done.returncode == 0, done.stderr
    for folder in map(Path, folders):
        assert {p.name for p in folder.iterdir()} == {
            p.name for p in finished[0].iterdir()
        }
        assert len(metrics(folder)) == UPDATES
        assert checkpoint(folder).name == checkpoint(finished[0]).name
    configs = [json.loads((Path(f) / "config.json").read_text()) for f in folders]
    assert [config["config"]["seed"] for config in configs] == [0, 1]
    first, second = (np.load(checkpoint(Path(folder))) for folder in folders)
    weights = [name for name in first.files if name != "header"]
    assert any((first[name] != second[name]).any() for name in weights)
    done = run(environment, "eval/evaluate.py", folders[0], "--episodes", "8")
    assert done.returncode == 0, done.stderr


def test_a_run_is_one_process_s_and_ctrl_c_leaves_a_checkpoint(finished, environment):
    folder = finished[0].parent / "stopped"
    arguments = (*TINY, "--num-steps", "10000000", "--checkpoint-minutes", "1000")
    flags = ("--runs-dir", str(folder.parent), "--name", "stopped")
    process = begin(environment, *arguments, *flags)
    wait_for_rows(process, folder, 3)
    second = run(environment, "train/ppo.py", "--resume", str(folder))
    assert second.returncode == 2
    assert second.stderr == (
        f"ppo: another process trains in {folder}: stop it or wait for its end\n"
    )
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert f"--resume {folder}" in out
    rows = metrics(folder)
    steps = int(rows[-1]["env_steps"])
    assert checkpoint(folder).name == f"step_{steps:012d}.npz"


def test_a_run_renders_to_a_still_and_a_video(finished, environment, tmp_path):
    size = ("--width", "320", "--height", "240")
    png, mp4 = tmp_path / "a.png", tmp_path / "a.mp4"
    for arguments in (
        ("--frame", "1", "--out", str(png)),
        ("--seconds", "1", "--out", str(mp4), "--camera", "chase:1"),
    ):
        done = run(environment, "eval/render.py", str(finished[0]), *size, *arguments)
        assert done.returncode == 0, done.stderr
    assert png.read_bytes()[:4] == b"\x89PNG"
    assert mp4.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize(
    ("program", "words", "said"),
    [
        ("train", "--preset cpu --env.num-agents 0", "num_agents must be at least 1"),
        ("train", "--preset cpu --env.num-parked-cars 35", "at most 34"),
        ("train", "--preset cpu --num-minibatches 7", "multiple of num_minibatches 7"),
        ("train", "--preset cpu --resume nowhere --seed 1", "drop --seed"),
        ("train", "--preset cpu --seeds 0-3", "seeds must be like 0..7 or 1,5,9"),
        ("train", "--preset cpu --runs-dir /proc/runs", "/proc/runs"),
        ("train", "--env.reward.extra.hste 1", "name in CARPARK_MJ_EXTENSIONS"),
        ("train", "--preset cpu --name ../../x", "not '../../x'"),
        ("evaluate", "nowhere", "no run folder or checkpoint at nowhere"),
        ("evaluate", "zero --out /proc/x", "/proc/x"),
    ],
)
def test_bad_input_is_one_clear_sentence_and_leaves_nothing(
    program, words, said, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, program, words.split(), said)
    assert list(tmp_path.iterdir()) == []


NAMES = ("discount=0.9,seed=0", "discount=0.99,seed=0")
SWEPT = 200  # updates
SWEEP = (
    # In one process, so that the kill leaves none behind.
    *("--base", "cpu", "--name", "tiny", "--stochastic", "--cluster", "debug"),
    *("--set", "discount=0.9,0.99", "minutes=0", "eval_episodes=4", "num_agents=1"),
    *("num_lots=4", "num_minibatches=2", "unroll_length=4"),
    *(f"num_steps={16 * SWEPT}", "checkpoint_minutes=1e-9"),
    *("num_parked_cars=4", "sim_dt=0.02", "physics=bicycle"),
    *("policy_layers=16", "value_layers=16"),
)


def test_a_killed_sweep_goes_on_from_its_checkpoints(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = {"JAX_NUM_CPU_DEVICES": "1", "COLUMNS": "200"}
    sweep = tmp_path / "runs/tiny"
    folders = [sweep / "runs" / name for name in NAMES]
    process = begin(given, *SWEEP, script="train/sweep.py")
    wait_for_rows(process, folders[1], 30)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    before = [metrics(folder) for folder in folders]
    assert all(30 <= len(found) < SWEPT for found in before)
    done = run(given, "train/sweep.py", *SWEEP)
    assert done.returncode == 0, done.stderr
    for folder, found in zip(folders, before, strict=True):
        after = metrics(folder)
        assert [int(row["update"]) for row in after] == list(range(1, SWEPT + 1))
        assert after[:20] == found[:20]  # not trained again: seconds are in it
    table = rows_of(sweep / "sweep.csv")
    assert [(row["run"], row["status"]) for row in table] == [
        (n, "done") for n in NAMES
    ]
    assert [row["discount"] for row in table] == ["0.9", "0.99"]
    assert all(0 <= float(row["parked"]) <= 1 for row in table)
    more = {"episodes": 4, "stochastic": True, "out": str(tmp_path / "alone")}
    evaluate.main(evaluate.EvaluateConfig(str(folders[1]), **more))
    alone = rows_of(tmp_path / "alone/evaluation.csv")
    assert alone == rows_of(folders[1] / "evaluation.csv")
