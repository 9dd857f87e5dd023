"""Trainers of sweeps that train nothing, importable by their jobs."""

import json
import os
import signal
import time

from carpark_mj.sweeps import run_folder
from carpark_mj.sweeps.plan import Plan, checked_runs, read_axis, settings_of
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.run_folder import describe


def plan_runs(*texts, repeats=1):
    """A plan and its runs."""
    axes = tuple(read_axis(text, PRESETS["square"]) for text in texts)
    plan = Plan("square", axes, repeats)
    return plan, checked_runs(plan)


def write_run(folder, config, **metrics):
    """What an evaluated run leaves, as far as analyses read it."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.json").write_text(json.dumps(describe(config)))
    summary = {"parked": {"rate": 0.5, "low": 0.4, "high": 0.6, "count": 8.0}}
    data = {"settings": {}, "summary": {**summary, **metrics}}
    (folder / "evaluation.json").write_text(json.dumps(data))


def train(runs, sweep, stochastic, tell):
    """Notes that it was called, and leaves an evaluation at once."""
    for run in runs:
        with (sweep / "calls.txt").open("a") as file:
            file.write(f"{run.name}\n")
        config = settings_of(run)
        write_run(run_folder(sweep, run), config, length=10.0 * config.env.num_agents)
        tell(run, "done", "")


def train_badly(runs, sweep, stochastic, tell):
    """Fails with two agents; with three its process is killed, the first time."""
    for run in runs:
        agents = settings_of(run).env.num_agents
        if agents == 2:
            raise ValueError("two are\na crowd")
        if agents == 3 and not (sweep / "killed").exists():
            (sweep / "killed").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        train([run], sweep, stochastic, tell)


def train_slowly(runs, sweep, stochastic, tell):
    """Ten steps, each noted in the run's folder, from which it goes on."""
    for run in runs:
        folder = run_folder(sweep, run)
        folder.mkdir(parents=True, exist_ok=True)
        steps = folder / "steps.txt"
        while (done := len(steps.read_text()) if steps.exists() else 0) < 10:
            with steps.open("a") as file:
                file.write(str(done))
            time.sleep(0.05)
        train([run], sweep, stochastic, tell)
