"""Deep Q-learning runs at the junction, from start to end."""

import contextlib
import dataclasses
from pathlib import Path
from typing import Any

import jax

from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import Loop, MetricsLog
from carpark_mj.training.run_folder import open_run, read_header
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.dqn.learner import DQNLearner, Report, Training
from carpark_papers.cederle.junction.evaluation import summarize
from carpark_papers.cederle.training.evaluations import (
    progress,
    summary,
    verdict,
    write_evaluations,
    write_video,
)

DQN_ALGORITHM = "dqn"  # `algorithm` in the header of a checkpoint


@dataclasses.dataclass
class Run:
    """A training with what it has found so far."""

    training: Training  # what learns
    evaluations: list[dict[str, Any]]  # rows of `evaluations.csv`
    chunks: int  # how often `DQNLearner.advance` has run


def load_or_init(learner: DQNLearner, folder: Path) -> Run:
    """The newest checkpoint of the run, or a fresh start if it has none."""
    if not runs.checkpoint_files(folder):
        return Run(learner.init(), [], 0)
    path = runs.latest_checkpoint(folder)
    header = read_header(path, type(learner.config), evaluations=list, chunks=int)
    tree = checkpoints.load(path, jax.eval_shape(learner.init))
    return Run(jax.device_put(tree), header["evaluations"], header["chunks"])


def save(folder: Path, config: DQNConfig, run: Run) -> None:
    """Writes a checkpoint with everything, the buffers as well."""
    steps = _steps(config, run)
    header = {
        "algorithm": DQN_ALGORITHM,
        "config": dataclasses.asdict(config),
        "evaluations": run.evaluations,
        "chunks": run.chunks,
        "env_steps": steps,
    }
    tree = jax.device_get(run.training)
    runs.save_checkpoint(folder, tree, header, steps)


def add_evaluation(folder: Path, learner: DQNLearner, run: Run) -> None:
    """Evaluates, unless it is done, and writes what was found."""
    config, steps = learner.config, _steps(learner.config, run)
    if not any(row["env_steps"] == steps for row in run.evaluations):
        outcomes = learner.evaluate(run.training.learners.params)
        row = summarize(outcomes, config.junction.traffic)
        run.evaluations.append({"env_steps": steps, **row})
    write_evaluations(folder, config, run.evaluations)


def train(config: DQNConfig, learner: DQNLearner, folder: Path) -> bool:
    """Trains until done, stopped or at the time limit; True when done."""
    print(f"run {folder} on {jax.devices()[0].device_kind}")
    print("compiling ...", flush=True)
    loop = Loop(config.algorithm, config)
    run = load_or_init(learner, folder)
    per_chunk = config.num_junctions * config.chunk
    finished = False
    with (
        loop.over(config.total_steps, _steps(config, run)),
        contextlib.closing(MetricsLog(folder, run.chunks, config)) as log,
    ):
        while True:
            finished = _steps(config, run) >= config.total_steps
            if finished or run.chunks % config.chunks_per_evaluation == 0:
                add_evaluation(folder, learner, run)
            leaving = finished or loop.stopping
            if leaving or loop.checkpoint_is_due:
                save(folder, config, run)
                loop.saved()
            if leaving:
                break
            run.training, report = learner.advance(run.training)
            run.chunks += 1
            log.write(_row(run.chunks, run.chunks * per_chunk, report))
            loop.show(_steps(config, run), progress(run.evaluations[-1]))
    print(summary(verdict(config, run.evaluations)))
    if finished:
        params = run.training.learners.params
        act = jax.jit(lambda observation: learner.greedy(params, observation))
        write_video(folder, config, act)
    return finished


def _steps(config: DQNConfig, run: Run) -> int:
    return run.chunks * config.chunk * config.num_junctions


def _row(chunk: int, env_steps: int, report: Report) -> dict[str, float]:
    episodes = int(report.episodes)
    mean = float(report.returned) / episodes if episodes else float("nan")
    return {
        "update": chunk,
        "env_steps": env_steps,
        "episodes": episodes,
        "episode/return": mean,
        "loss": float(report.loss),
    }


def train_run(config: DQNConfig) -> tuple[Path, bool]:
    """Trains a run; returns its folder and whether it is finished."""
    learner = DQNLearner(config)
    with open_run(config) as folder:
        return folder, train(config, learner, folder)
