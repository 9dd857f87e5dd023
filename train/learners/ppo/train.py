"""A PPO run: the loop over updates, and the outputs at its end."""

import contextlib
import dataclasses
import sys
from pathlib import Path
from typing import Any

import jax

from carpark_mj.policy import checkpoints, runs
from learners.loop import Loop
from learners.ppo.config import PPOConfig
from learners.ppo.curve import plot_learning_curve
from learners.ppo.learner import Learner
from learners.ppo.metrics_log import MetricsLog
from learners.ppo.state import TrainingState

MAX_SKIPPED = 5  # updates in a row that may come out non-finite


class TrainingDivergedError(Exception):
    """Updates keep coming out non-finite."""


def print_settings(config: PPOConfig, folder: Path, learner: Learner) -> None:
    """Prints every setting, one a line."""
    device = jax.devices()[0]
    print(f"run {folder} on {learner.mesh.size} x {device.device_kind}")

    def lines(prefix: str, settings: dict[str, Any]) -> None:
        for name, value in settings.items():
            if isinstance(value, dict):
                lines(f"{prefix}{name}.", value)
            else:
                print(f"  {prefix}{name} = {value}")

    lines("", dataclasses.asdict(config))


def load_or_init(learner: Learner, folder: Path) -> TrainingState:
    """The newest checkpoint of the run, or a fresh state if it has none."""
    if not runs.checkpoint_files(folder):
        return learner.init()
    path = runs.latest_checkpoint(folder)
    template = vars(learner.shapes())
    return learner.place(TrainingState(**checkpoints.load(path, template)))


def save(folder: Path, config: PPOConfig, state: TrainingState) -> Path:
    """Writes a checkpoint of the state."""
    update = int(state.update)
    steps = update * config.steps_per_update
    header = {
        "config": dataclasses.asdict(config),
        "update": update,
        "env_steps": steps,
    }
    return runs.save_checkpoint(folder, vars(jax.device_get(state)), header, steps)


def train(config: PPOConfig, learner: Learner, folder: Path) -> bool:
    """Trains until done, stopped or out of time; True when done.

    Raises:
        TrainingDivergedError: the updates keep coming out non-finite.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    print_settings(config, folder, learner)
    print("compiling ...", flush=True)
    loop = Loop("PPO", config)
    state = load_or_init(learner, folder)
    update = learner.compile()
    first = done = int(state.update)
    skipped, in_a_row = int(state.skipped), 0
    begun = 0.0
    log = MetricsLog(folder, done)
    leaving = False
    with loop.over(config.num_updates, done), contextlib.closing(log):
        while done < config.num_updates and not leaving:
            state, metrics = update(state)
            row = {name: float(x) for name, x in jax.device_get(metrics).items()}
            done += 1
            begun = begun or loop.seconds  # the first update includes compilation
            made = (done - first - 1) * config.steps_per_update
            rate = made / (loop.seconds - begun) if made else 0.0
            in_a_row = in_a_row + 1 if row["skipped"] > skipped else 0
            skipped = int(row["skipped"])
            if in_a_row >= MAX_SKIPPED:
                raise TrainingDivergedError(
                    f"{in_a_row} updates in a row came out non-finite; the checkpoints "
                    f"in {folder} are from before"
                )
            steps = done * config.steps_per_update
            log.write(
                {
                    "update": done,
                    "env_steps": steps,
                    "seconds": loop.seconds,
                    "steps_per_second": rate,
                    **row,
                }
            )
            loop.show(
                done,
                f"{steps / 1e6:.2f} M  {rate:>7,.0f} steps/s  "
                f"[green]parked {row['episode/parked']:5.1%}[/]  "
                f"[red]crashed {row['episode/crashed']:5.1%}[/]",
            )
            leaving = loop.stopping
            due = loop.checkpoint_is_due
            if config.checkpoint_updates:
                due = done % config.checkpoint_updates == 0
            if due or leaving or done == config.num_updates:
                save(folder, config, state)
                loop.saved()
    return done == config.num_updates


def finish(config: PPOConfig, folder: Path) -> None:
    """Learning curve, evaluation on held-out seeds and a video of the trained policy.

    Every part is made anew from what lies in the folder.
    """
    print(f"wrote {plot_learning_curve(folder)}")
    if config.eval_episodes:
        from carpark_mj.cli import evaluate

        evaluate.main(
            evaluate.EvaluateConfig(run=str(folder), episodes=config.eval_episodes)
        )
    if config.video_seconds:
        from carpark_mj.cli import render

        try:
            render.main(
                render.RenderConfig(run=str(folder), seconds=config.video_seconds)
            )
        except render.RenderingError as error:
            print(f"no video: {error}", file=sys.stderr)
