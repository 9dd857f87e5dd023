"""Trains one shared parking policy for all agents with PPO (IPPO).

    python train/ppo.py                      # preset by hardware, runs/cpu-0 or gpu-0
    python train/ppo.py --resume runs/cpu-0  # goes on exactly where it was
    python train/ppo.py --preset tanner-fixed  # the study's grid world
    python train/ppo.py --help               # every setting

Ctrl-C finishes the update, saves a checkpoint and stops; a second one stops at once.
"""

import dataclasses
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from carpark_mj.cli.common import USER_ERRORS, keep_compiled_programs, one_line
from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before MuJoCo is imported; without GL there is no video at the end

import jax

from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.checkpoints import CheckpointError
from flags import read_flags
from learner import Learner, TrainingState
from logger import MetricsLog, progress_bar
from presets import PRESETS, PPOConfig
from run_folder import StopRequest, open_run

MAX_SKIPPED = 5  # updates in a row that may come out non-finite
LINE_SECONDS = 20.0  # between lines of progress where there is no terminal


class TrainingDivergedError(Exception):
    """Updates keep coming out non-finite."""


def configure_jax() -> None:
    """One CPU device per core, over which the lots are sharded."""
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    # jaxlib 0.11.2 crashes compiling a program for several CPU devices; 0.10.2 is fine.
    if jax.__version_info__ < (0, 11):
        jax.config.update("jax_num_cpu_devices", cores or 1)


def parse(arguments: Sequence[str] | None = None) -> PPOConfig:
    """Reads the flags; see `read_flags`. Without a preset the hardware chooses one."""
    hardware = "gpu" if jax.default_backend() == "gpu" else "cpu"
    return read_flags(PRESETS[hardware], PRESETS, arguments, __doc__)


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
    template = vars(jax.eval_shape(learner.build))
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
    started = time.monotonic()
    print_settings(config, folder, learner)
    print("compiling ...", flush=True)
    state = load_or_init(learner, folder)
    update = learner.compile()
    done = int(state.update)
    first, skipped = done, int(state.skipped)
    log = MetricsLog(folder, done)
    stop = StopRequest()
    saved_at = time.monotonic()
    printed_at, begun = saved_at, 0.0
    in_a_row = 0
    with progress_bar() as progress:
        task = progress.add_task(
            "train",
            total=config.num_updates,
            completed=done,
            steps="",
            rate=0.0,
            parked=0.0,
            crashed=0.0,
        )
        while done < config.num_updates:
            state, metrics = update(state)
            row = {name: float(x) for name, x in jax.device_get(metrics).items()}
            done += 1
            now = time.monotonic()
            begun = begun or now  # the first update includes compilation
            made = (done - first - 1) * config.steps_per_update
            rate = made / (now - begun) if made else 0.0
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
                    "seconds": now - started,
                    "steps_per_second": rate,
                    **row,
                }
            )
            shown: dict[str, Any] = {
                "steps": f"{steps / 1e6:.2f} M",
                "rate": rate,
                "parked": row["episode/parked"],
                "crashed": row["episode/crashed"],
            }
            progress.update(task, completed=done, **shown)
            if not progress.console.is_terminal and now - printed_at > LINE_SECONDS:
                printed_at = now
                steps_left = (config.num_updates - done) * config.steps_per_update
                left = f"{steps_left / rate / 60:.1f} min left" if rate else ""
                print(
                    f"{shown['steps']}  {rate:,.0f} steps/s  "
                    f"parked {shown['parked']:.1%}  crashed {shown['crashed']:.1%}  "
                    f"{left}",
                    flush=True,
                )
            out_of_time = 0 < config.time_limit * 60 <= now - started
            due = now - saved_at > config.checkpoint_minutes * 60
            if config.checkpoint_updates:
                due = done % config.checkpoint_updates == 0
            finished = done == config.num_updates
            if due or out_of_time or stop.requested or finished:
                save(folder, config, state)
                saved_at = time.monotonic()
            if out_of_time or stop.requested:
                break
    log.close()
    return done == config.num_updates


def finish(config: PPOConfig, folder: Path) -> None:
    """Learning curve, evaluation on held-out seeds and a video of the trained policy.

    Every part is made anew from what lies in the folder.
    """
    from curve import plot_learning_curve

    print(f"wrote {plot_learning_curve(folder)}")
    root = Path(__file__).resolve().parents[1]
    sys.path.insert(0, str(root / "eval"))
    if config.eval_episodes:
        import evaluate

        evaluate.main(
            evaluate.EvaluateConfig(run=str(folder), episodes=config.eval_episodes)
        )
    if config.video_seconds:
        import render

        try:
            render.main(
                render.RenderConfig(run=str(folder), seconds=config.video_seconds)
            )
        except render.RenderingError as error:
            print(f"no video: {error}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    configure_jax()
    keep_compiled_programs()
    try:
        config = parse(arguments)
        learner = Learner(config)  # refuses impossible lots before a folder is made
        folder = open_run(config)
        if not train(config, learner, folder):
            print(f"stopped; go on with: python train/ppo.py --resume {folder}")
            return 0
        finish(config, folder)
    except (CheckpointError, *USER_ERRORS) as error:
        print(f"ppo: {one_line(error)}", file=sys.stderr)
        return 2
    except TrainingDivergedError as error:
        print(f"ppo: {error}", file=sys.stderr)
        return 1
    print(f"done: {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
