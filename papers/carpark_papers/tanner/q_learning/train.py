"""A Q-learning run: the loop over chunks of steps, and its files."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import Loop
from carpark_mj.training.run_folder import read_header
from carpark_papers.tanner.q_learning.config import QLearningConfig
from carpark_papers.tanner.q_learning.curve import (
    plot_returns,
    summary,
    write_metrics,
)
from carpark_papers.tanner.q_learning.learner import (
    CHUNK,
    Finished,
    QLearner,
    Training,
)


@dataclasses.dataclass
class Run:
    """A training and its results so far.

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
    header = read_header(path, type(config), chunks=int)
    tree = checkpoints.load(path, template)
    episodes = {name: np.array(record) for name, record in tree.pop("history").items()}
    training = Training(**jax.device_put(tree))
    return Run(training, episodes, header["chunks"])


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
    states, actions = learner.table_shape
    print(f"run {folder}: {config.num_seeds} tables of {states} x {actions}")
    print("compiling ...", flush=True)
    loop = Loop("Q-learning", config)
    run = load_or_init(learner, folder)
    with loop.over(config.total_episodes, int(run.counts.min())):
        while True:
            count = int(run.counts.min())
            recent = run.episodes["episode_return"][:, max(0, count - config.window) :]
            returned = recent[:, : config.window].mean() if count else np.nan
            loop.show(count, f"{count:,} episodes  [green]return {returned:6.2f}[/]")
            finished = count == config.total_episodes
            leaving = finished or loop.stopping
            if leaving or loop.checkpoint_is_due:
                save(folder, config, run)
                loop.saved()
            if leaving:
                break
            run.training, ended = learner.advance(run.training)
            run.add(jax.device_get(ended))
            run.chunks += 1
    print("\n".join(summary(config, run.episodes)))
    return finished
