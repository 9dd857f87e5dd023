"""Runs of BenchMARL's algorithms at the junction, from start to end."""

# Its types do not fit its own use, and it may be absent.
# pyright: basic, reportMissingImports=false, reportIncompatibleMethodOverride=false

import contextlib
import dataclasses
import io
import logging
import math
import os
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np
import torch
from benchmarl.experiment import Callback, Experiment
from tensordict import TensorDictBase

from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.loop import Loop, MetricsLog
from carpark_mj.training.run_folder import open_run, read_header
from carpark_mj.wrappers.torchrl import GROUP
from carpark_papers.cederle.benchmarl.build import (
    Evaluation,
    GreedyPolicy,
    make_algorithm,
    make_model,
    make_settings,
    make_task,
)
from carpark_papers.cederle.benchmarl.config import BenchMARLConfig
from carpark_papers.cederle.junction.evaluation import summarize
from carpark_papers.cederle.training.evaluations import (
    progress,
    summary,
    verdict,
    write_evaluations,
    write_video,
)


class Stopped(KeyboardInterrupt):
    """Ends BenchMARL's loop as Ctrl-C does, when everything has been saved."""


class Training(Experiment):
    """BenchMARL's experiment, with our log and evaluations after each iteration.

    Attributes:
        evaluations: rows of `evaluations.csv`.
    """

    def __init__(self, config: BenchMARLConfig, folder: Path) -> None:
        """Builds it, or continues with the newest checkpoint of the run."""
        self._run, self._folder = config, folder
        self._evaluation = Evaluation(config)
        self._monitor = Monitor()
        self._last_policy: GreedyPolicy | None = None
        self.evaluations: list[dict[str, Any]] = []
        device = torch.from_dlpack(jax.numpy.zeros(1)).device
        if device.type == "cpu":
            torch.set_num_threads(1)  # JAX has the other cores
        scratch = folder / "benchmarl"
        scratch.mkdir(exist_ok=True)
        super().__init__(
            task=make_task(config),
            algorithm_config=make_algorithm(config),
            model_config=make_model(config),
            critic_model_config=make_model(config),
            seed=config.seed,
            config=make_settings(config, scratch, device),
            callbacks=[self._monitor],
        )
        if config.algorithm == "maddpg":
            critic = self.optimizers[GROUP]["loss_value"]
            critic.param_groups[0]["lr"] = config.critic_learning_rate
        if runs.checkpoint_files(folder):
            self._load(runs.latest_checkpoint(folder))

    @property
    def env_steps(self) -> int:
        """Control steps of all junctions so far."""
        return self.total_frames * self._run.repeat

    def train(self) -> bool:
        """Trains until done, stopped or at the time limit; True when done."""
        config = self._run
        self._loop = Loop(config.algorithm, config)
        with (
            self._loop.over(config.iterations * config.frames, self.env_steps),
            contextlib.closing(
                MetricsLog(self._folder, self.n_iters_performed, config)
            ) as log,
        ):
            self._log = log
            self._evaluate()
            if self.n_iters_performed < config.iterations:
                with contextlib.suppress(Stopped):
                    self.run()
            else:  # it had come to its end before
                self._last_policy = self.greedy_policy(config.video_episodes)
        print(summary(verdict(config, self.evaluations)))
        finished = self.n_iters_performed >= config.iterations
        if finished and self._last_policy:
            write_video(self._folder, config, self._last_policy)
        return finished

    def _save_experiment(self) -> None:
        """Called by BenchMARL at the end of an iteration."""
        config, done = self._run, self.n_iters_performed
        finished = done >= config.iterations
        if config.on_policy:  # what is best must end up most likely, too
            left = 1.0 - done / config.iterations
            self.losses[GROUP].entropy_coeff.fill_(config.entropy * left)
        if finished or done % config.iterations_per_evaluation == 0:
            self._evaluate()
        counts = {"update": done, "env_steps": self.env_steps}
        self._log.write(counts | self._monitor.row())
        self._loop.show(self.env_steps, progress(self.evaluations[-1]))
        leaving = finished or self._loop.stopping
        if leaving or self._loop.checkpoint_is_due:
            self._save()
            self._loop.saved()
        if finished:  # BenchMARL closes its environments behind this
            self._last_policy = self.greedy_policy(config.video_episodes)
        elif leaving:
            raise Stopped

    def greedy_policy(self, episodes: int) -> GreedyPolicy:
        """Standing at the start of at most `eval_episodes` episodes."""
        return GreedyPolicy(self.policy, self.test_env.reset()[:episodes])

    def _evaluate(self) -> None:
        if any(row["env_steps"] == self.env_steps for row in self.evaluations):
            return
        outcomes = self._evaluation(self.greedy_policy(self._run.eval_episodes))
        row = summarize(outcomes, self._run.junction.traffic)
        self.evaluations.append({"env_steps": self.env_steps, **row})
        write_evaluations(self._folder, self._run, self.evaluations)

    def _save(self) -> None:
        """Writes a checkpoint with everything but the junctions under way."""
        optimizers = {k: o.state_dict() for k, o in self.optimizers[GROUP].items()}
        file = io.BytesIO()
        torch.save({"experiment": self.state_dict(), "optimizers": optimizers}, file)
        header = {
            "algorithm": self._run.algorithm,
            "config": dataclasses.asdict(self._run),
            "evaluations": self.evaluations,
            "env_steps": self.env_steps,
            "bytes": len(file.getbuffer()),
        }
        tree = {"torch": np.frombuffer(file.getbuffer(), np.uint8)}
        runs.save_checkpoint(self._folder, tree, header, self.env_steps)

    def _load(self, path: Path) -> None:
        header = read_header(path, type(self._run), bytes=int, evaluations=list)
        template = {"torch": np.zeros(header["bytes"], np.uint8)}
        stored = checkpoints.load(path, template)["torch"]
        state = torch.load(io.BytesIO(stored.tobytes()), weights_only=True)
        self.load_state_dict(state["experiment"])
        for name, optimizer in self.optimizers[GROUP].items():
            optimizer.load_state_dict(state["optimizers"][name])
        self.evaluations = header["evaluations"]


class Monitor(Callback):
    """Collects the values of a row of `metrics.csv`."""

    def __getstate__(self) -> dict[str, Any]:
        """Nothing: BenchMARL pickles callbacks, and with them the experiment."""
        return {}

    def on_batch_collected(self, batch: TensorDictBase) -> None:
        """Counts the episodes that ended."""
        over = batch["next", "done"][..., 0]
        returns = batch["next", GROUP, "episode_reward"].sum(dim=(-2, -1))[over]
        self._episodes, self._returns = returns.numel(), returns.mean().item()

    def on_train_end(self, training_td: TensorDictBase, group: str) -> None:
        """Averages losses and what else the updates report."""
        self._losses = {
            name: value.float().mean().item()
            for name, value in training_td.items()
            if value.numel() == training_td.numel()
        }

    def row(self) -> dict[str, float]:
        """Of the last iteration."""
        mean = self._returns if self._episodes else math.nan
        return {"episodes": self._episodes, "episode/return": mean, **self._losses}


# Read when they are imported: our bar is the one shown, and JAX shares a GPU.
os.environ.setdefault("TQDM_DISABLE", "1")
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def train_run(config: BenchMARLConfig) -> tuple[Path, bool]:
    """Trains a run; returns its folder and whether it is finished."""
    with open_run(config) as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="No episode terminated")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        logging.getLogger("torchrl").setLevel(logging.WARNING)
        print(f"run {folder}")
        print("compiling ...", flush=True)
        return folder, Training(config, folder).train()
