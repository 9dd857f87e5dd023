"""A PPO run: the loop over updates, and the outputs at its end."""

import contextlib
import dataclasses
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import jax

from carpark_mj.policy import checkpoints, runs
from learners import hosts
from learners.loop import Loop
from learners.ppo.config import PPOConfig
from learners.ppo.curve import plot_learning_curve
from learners.ppo.forecast import MEASURED_SECONDS, announcement, estimate
from learners.ppo.learner import Learner
from learners.ppo.metrics_log import MetricsLog
from learners.ppo.state import TrainingState

MAX_SKIPPED = 5  # updates in a row that may come out non-finite


class TrainingDivergedError(Exception):
    """Updates keep coming out non-finite."""


def print_settings(config: PPOConfig, folder: Path, learner: Learner) -> None:
    """Prints every setting, one a line."""
    device = jax.devices()[0]
    where = f"{learner.mesh.size} x {device.device_kind}"
    if jax.process_count() > 1:
        where += f" of {jax.process_count()} hosts"
    print(f"run {folder} on {where}")

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
    """Writes a checkpoint of the state, which is in the host's memory."""
    update = int(state.update)
    steps = update * config.steps_per_update
    header = {
        "config": dataclasses.asdict(config),
        "update": update,
        "env_steps": steps,
    }
    return runs.save_checkpoint(folder, vars(state), header, steps)


def train(
    config: PPOConfig,
    learner: Learner,
    folder: Path,
    clock: Callable[[], float] = time.monotonic,
) -> bool:
    """Trains until done, stopped or at the time limit; True when done.

    It is done after `num_steps`, or after `minutes` if that is sooner.

    Args:
        config: of the run.
        learner: of the config.
        folder: of the run; only host 0 writes to it.
        clock: gives the time [s].

    Raises:
        TrainingDivergedError: the updates keep coming out non-finite.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    print_settings(config, folder, learner)
    loop = Loop("PPO", config, clock)
    state = load_or_init(learner, folder)
    update = learner.compile()
    first = done = int(state.update)
    used = float(state.seconds)  # by the runs that this one continues
    print(announcement(config, done, used))
    print("compiling ...", flush=True)
    skipped, in_a_row = int(state.skipped), 0
    begun = 0.0
    leaving = told = False
    progress = float(config.progress(done, used))
    with loop.over(1.0, progress), _metrics(folder, done) as log:
        while progress < 1.0 and not leaving:
            state, metrics = update(state)
            row = {name: float(x) for name, x in jax.device_get(metrics).items()}
            done += 1
            due = loop.checkpoint_is_due
            seconds, leaving, due = hosts.largest(
                used + loop.seconds, loop.stopping, due
            )
            progress = float(config.progress(done, seconds))
            if config.minutes:
                state = learner.set_seconds(state, seconds)
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
            log(
                {
                    "update": done,
                    "env_steps": steps,
                    "seconds": loop.seconds,
                    "steps_per_second": rate,
                    **row,
                }
            )
            if not told and made and loop.seconds - begun > MEASURED_SECONDS:
                loop.say(estimate(config, done, seconds, rate))
                told = True
            loop.show(
                progress,
                f"{steps / 1e6:.2f} M  {rate:>7,.0f} steps/s  "
                f"[green]parked {row['episode/parked']:5.1%}[/]  "
                f"[red]crashed {row['episode/crashed']:5.1%}[/]",
            )
            if config.checkpoint_updates:
                due = done % config.checkpoint_updates == 0
            if due or leaving or progress >= 1.0:
                whole = learner.gather(state)
                hosts.on_first(lambda whole=whole: save(folder, config, whole))
                loop.saved()
    return progress >= 1.0


@contextlib.contextmanager
def _metrics(folder: Path, done: int) -> Generator[Callable[[dict[str, float]], None]]:
    """What writes a row of metrics; on host 0 alone."""
    if not hosts.is_first():
        yield lambda row: None
        return
    with contextlib.closing(MetricsLog(folder, done)) as log:
        yield log.write


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
