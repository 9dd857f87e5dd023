"""`python train/sweep.py` as a user runs it: killed in the middle, and run again."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from carpark_mj.cli import evaluate

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("discount=0.9,seed=0", "discount=0.99,seed=0")
UPDATES = 200
COMMAND = (
    *(sys.executable, str(ROOT / "train/sweep.py"), "--base", "cpu", "--name", "tiny"),
    # In one process, so that the kill leaves none behind.
    *("--stochastic", "--cluster", "debug", "--set", "discount=0.9,0.99", "minutes=0"),
    *("num_lots=4", "num_minibatches=2", "unroll_length=4", "num_agents=1"),
    *(f"num_steps={16 * UPDATES}", "checkpoint_minutes=1e-9", "eval_episodes=4"),
    *("num_parked_cars=4", "sim_dt=0.02", "physics=bicycle"),
    *("policy_layers=16", "value_layers=16"),
)


def rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """The folder of a sweep killed in its training, and its environment."""
    folder = tmp_path_factory.mktemp("sweep")
    environment = os.environ | {"JAX_NUM_CPU_DEVICES": "1", "COLUMNS": "200"}
    process = subprocess.Popen(
        COMMAND,
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    metrics = folder / "runs/tiny/runs" / NAMES[1] / "metrics.csv"
    while process.poll() is None and len(rows(metrics)) < 30:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.returncode == -signal.SIGKILL
    return folder, environment


def test_a_killed_sweep_goes_on_from_its_checkpoints(killed):
    folder, environment = killed
    sweep = folder / "runs/tiny"
    before = [rows(sweep / "runs" / name / "metrics.csv") for name in NAMES]
    assert all(30 <= len(found) < UPDATES for found in before)
    done = subprocess.run(
        COMMAND,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for name, found in zip(NAMES, before, strict=True):
        after = rows(sweep / "runs" / name / "metrics.csv")
        assert [int(row["update"]) for row in after] == list(range(1, UPDATES + 1))
        assert after[:20] == found[:20]  # not trained again: seconds are in it
    table = rows(sweep / "sweep.csv")
    assert [(row["run"], row["status"]) for row in table] == [
        (n, "done") for n in NAMES
    ]
    assert [row["discount"] for row in table] == ["0.9", "0.99"]
    assert all(0 <= float(row["parked"]) <= 1 for row in table)
    evaluate.main(
        evaluate.EvaluateConfig(
            str(sweep / "runs" / NAMES[1]),
            episodes=4,
            stochastic=True,
            out=str(folder / "alone"),
        )
    )
    alone = rows(folder / "alone/evaluation.csv")
    assert alone == rows(sweep / "runs" / NAMES[1] / "evaluation.csv")
