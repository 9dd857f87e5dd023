"""Trains by tabular Q-learning on the grid: the first experiments of Tanner 2022.

    python train/q_learning.py                                    # figure 5.1
    python train/q_learning.py --preset tanner-qlearning-rings    # figure 5.2
    python train/q_learning.py --resume runs/tanner-qlearning-0   # goes on where it was

Independent Q-learning with one table for all agents, several seeds side by side. In
`runs/<name>/` lie `config.json`, checkpoints, `metrics.csv` and `learning_curve.png`.
Ctrl-C saves a checkpoint and stops.
"""

import dataclasses
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from carpark_mj.cli.common import USER_ERRORS, keep_compiled_programs, one_line
from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.checkpoints import CheckpointError
from flags import read_flags
from q_curve import plot_returns, summary, write_metrics
from q_learner import CHUNK, Finished, QLearner, Training
from q_presets import Q_PRESETS, QLearningConfig
from run_folder import StopRequest, open_run

LINE_SECONDS = 20.0  # between lines of progress where there is no terminal


@dataclasses.dataclass
class Run:
    """A training with what it has made so far.

    Attributes:
        training: of all seeds.
        episodes: by name (num_seeds, total_episodes): `episode_return` float32,
            `length` int32 and `outcome` int8, -1 where there is none yet.
        chunks: how often `QLearner.advance` has run.
    """

    training: Training
    episodes: dict[str, np.ndarray]
    chunks: int

    @property
    def counts(self) -> np.ndarray:
        """(num_seeds,) episodes recorded."""
        return (self.episodes["outcome"] >= 0).sum(axis=1)

    def add(self, finished: Finished) -> None:
        """Appends the episodes of a chunk, (CHUNK, num_seeds, num_lots, num_agents)."""
        for seed, start in enumerate(self.counts):
            done = np.asarray(finished.done)[:, seed]
            for name, record in self.episodes.items():
                ended = np.asarray(getattr(finished, name))[:, seed][done]
                part = record[seed, start : start + len(ended)]
                part[:] = ended[: len(part)]


def load_or_init(learner: QLearner, folder: Path) -> Run:
    """The newest checkpoint of the run, or a fresh start if it has none."""
    config = learner.config
    shape = (config.num_seeds, config.total_episodes)
    episodes = {
        "episode_return": np.zeros(shape, np.float32),
        "length": np.zeros(shape, np.int32),
        "outcome": np.full(shape, -1, np.int8),
    }
    if not runs.checkpoint_files(folder):
        return Run(learner.init(), episodes, 0)
    path = runs.latest_checkpoint(folder)
    template = vars(jax.eval_shape(learner.init)) | {"history": episodes}
    tree = checkpoints.load(path, template)
    episodes = {name: np.array(record) for name, record in tree.pop("history").items()}
    training = Training(**jax.device_put(tree))
    return Run(training, episodes, checkpoints.read_header(path)["chunks"])


def save(folder: Path, config: QLearningConfig, run: Run) -> None:
    """Writes checkpoint, metrics and plot."""
    counts = run.counts
    recent = [
        run.episodes["episode_return"][seed, max(count - config.window, 0) : count]
        for seed, count in enumerate(counts)
    ]
    means = [part.mean() if len(part) else -np.inf for part in recent]
    steps = run.chunks * CHUNK * config.num_lots * config.env.num_agents
    header: dict[str, Any] = {
        "algorithm": runs.Q_LEARNING,
        "config": dataclasses.asdict(config),
        "chunks": run.chunks,
        "env_steps": steps * config.num_seeds,
        "best": int(np.argmax(means)),
    }
    tree = vars(jax.device_get(run.training)) | {"history": run.episodes}
    runs.save_checkpoint(folder, tree, header, header["env_steps"])
    write_metrics(folder, config, run.episodes)
    plot_returns(folder, config, run.episodes)


def train(config: QLearningConfig, learner: QLearner, folder: Path) -> bool:
    """Trains until done, stopped or out of time; True when done.

    Raises:
        CheckpointError: a checkpoint to resume from is damaged.
    """
    started = saved_at = printed_at = time.monotonic()
    states, actions = learner.table_shape
    print(f"run {folder}: {config.num_seeds} tables of {states} x {actions}")
    print("compiling ...", flush=True)
    run = load_or_init(learner, folder)
    stop = StopRequest()
    columns = (
        TextColumn("[bold]Q-learning"),
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TextColumn("{task.completed:,} of {task.total:,} episodes"),
        TextColumn("[green]return {task.fields[returned]:6.2f}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns) as progress:
        task = progress.add_task("", total=config.total_episodes, returned=np.nan)
        while True:
            count = int(run.counts.min())
            recent = run.episodes["episode_return"][:, max(0, count - config.window) :]
            returned = recent[:, : config.window].mean() if count else np.nan
            progress.update(task, completed=count, returned=returned)
            finished = count == config.total_episodes
            now = time.monotonic()
            if not progress.console.is_terminal and now - printed_at > LINE_SECONDS:
                printed_at = now
                print(f"{count:,} episodes  return {returned:.2f}", flush=True)
            out_of_time = 0 < config.time_limit * 60 <= now - started
            leaving = finished or out_of_time or stop.requested
            if leaving or now - saved_at > config.checkpoint_minutes * 60:
                save(folder, config, run)
                saved_at = time.monotonic()
            if leaving:
                break
            run.training, ended = learner.advance(run.training)
            run.add(jax.device_get(ended))
            run.chunks += 1
    print("\n".join(summary(config, run.episodes)))
    return finished


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    keep_compiled_programs()
    try:
        config = read_flags(QLearningConfig(), Q_PRESETS, arguments, __doc__)
        learner = QLearner(config)  # refuses impossible lots before a folder is made
        folder = open_run(config)
        if not train(config, learner, folder):
            print(f"stopped; go on with: python train/q_learning.py --resume {folder}")
            return 0
    except (CheckpointError, *USER_ERRORS) as error:
        print(f"q_learning: {one_line(error)}", file=sys.stderr)
        return 2
    print(f"done: {folder}; see {folder / 'learning_curve.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
