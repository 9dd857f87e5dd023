"""Training of PPO runs: the loop over updates, checkpoints, and what a run leaves."""

import contextlib
import dataclasses
import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import jax
import numpy as np

from carpark_mj.cli.clock import DRAWING, TRAINING, doing
from carpark_mj.policy import checkpoints, runs
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.training import hosts
from carpark_mj.training.loggers import (
    CALLBACKS,
    open_callbacks,
    scheduled,
    split_names,
)
from carpark_mj.training.loop import Loop, MetricsLog, plot_learning_curve
from carpark_mj.training.ppo.collect import TrainingState, count_steps
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.group import make_learner
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.warm_start import require_run, warm_start
from carpark_mj.training.run_folder import argument, open_run, read_header, require_new

MAX_SKIPPED = 5  # updates in a row that may come out non-finite
FEW_UPDATES = 20  # below this many a policy has hardly changed

# Whether a run came to its end, was stopped before, or kept coming out non-finite.
Outcome = Literal["done", "stopped", "diverged"]

# Gets the number of a run and the metrics of its update; True stops all runs.
Callback = Callable[[int, dict[str, float]], bool]


def finish(config: PPOConfig, folder: Path, stochastic: bool = False) -> None:
    """Makes learning curve, evaluation on held-out seeds and video of a run folder.

    A `stochastic` policy is evaluated on sampled actions.
    """
    print(f"wrote {plot_learning_curve(folder)}")
    run = argument(folder)
    if config.eval_episodes:
        from carpark_mj.cli import evaluate

        settings = evaluate.EvaluateConfig(
            run, episodes=config.eval_episodes, stochastic=stochastic, out=run
        )
        evaluate.main(settings)
    if config.video_seconds:
        from carpark_mj.cli import render

        try:
            video = render.main(render.RenderConfig(run, seconds=config.video_seconds))
        except render.RenderingError as error:
            print(f"no video: {error}", file=sys.stderr)
            return
        with contextlib.closing(MetricsLog(folder, math.inf, config)) as log:
            log.video(video)


def train_runs(
    configs: Sequence[PPOConfig],
    finish_run: Callable[[PPOConfig, Path], None] | None = finish,
    callback: Callback | None = None,
) -> list[tuple[Path, Outcome]]:
    """Trains runs side by side, and finishes those done; gives folders and outcomes.

    Their configs have equal `group.program`; either all are new or all are resumed. The
    folders are host 0's.
    """
    for config in configs:
        for name in split_names(config.callbacks):
            CALLBACKS[name]  # refused before there is a folder
        if not config.resume:
            require_run(config)
    hosts.on_first(lambda: [require_new(config) for config in configs])
    learner = make_learner(configs)
    if any(config.stored_lots for config in configs):
        doing(DRAWING)
    learner.shapes()  # refuses impossible lots before a folder is made
    hosts.require_same(repr(configs))
    with contextlib.ExitStack() as stack:
        opened = hosts.on_first(
            lambda: [stack.enter_context(open_run(config)) for config in configs]
        )
        # Others only read the checkpoint of a run to resume, if it is one.
        folders = opened or [Path(c.resume or c.runs_dir) for c in configs]
        outcomes = train(learner, folders, callback=callback)
        if jax.process_count() > 1:  # each continues alone, or ends
            jax.distributed.shutdown()
        ended = list(zip(folders, outcomes, strict=True))
        if hosts.is_first() and finish_run is not None:
            for config, (folder, outcome) in zip(configs, ended, strict=True):
                if outcome == "done":
                    finish_run(config, folder)
    return ended


def train(
    learner: Learner,
    folders: Sequence[Path],
    clock: Callable[[], float] = time.monotonic,
    callback: Callback | None = None,
) -> list[Outcome]:
    """Trains until done, stopped or at the time limit; returns each run's outcome.

    Runs are done after `num_steps`, or after `minutes` if that is sooner. One that
    diverges stops writing; its checkpoints are from before. Only host 0
    writes to the folders; every one calls the callback after every update of every run.
    """
    config, count = learner.config, len(folders)
    where = f"{learner.mesh.size} x {jax.devices()[0].device_kind}"
    if jax.process_count() > 1:
        where += f" of {jax.process_count()} hosts"
    names = ", ".join(map(str, folders))
    print(f"run {names} on {where}; settings in config.json there")
    loop = Loop("PPO", config, clock)
    state = load_or_init(learner, folders)
    hooks = [
        open_callbacks(own.callbacks, own, folder)
        for own, folder in zip(learner.configs, folders, strict=True)
    ]
    update = learner.compile(any(hooks))
    first = done = int(np.ravel(state.update)[0])
    used = float(np.ravel(state.seconds)[0])  # by the runs that these continue
    print(announcement(config, done, used))
    doing(TRAINING)
    skipped, in_a_row = np.ravel(state.skipped), np.zeros(count)
    diverged = np.zeros(count, bool)
    begun, at_begin = 0.0, count_steps(state)  # at the end of the first update
    leaving = asked = False
    progress = float(config.progress(done, used))
    with contextlib.ExitStack() as stack:
        stack.enter_context(loop.over(1.0, progress))
        logs = [
            stack.enter_context(contextlib.closing(MetricsLog(folder, done, own)))
            for folder, own in zip(folders, learner.configs, strict=True)
            if hosts.is_first()
        ]
        while progress < 1.0 and not leaving and not diverged.all():
            given = [learner.as_arrays([scheduled(own, progress) for own in hooks])]
            state, metrics = update(state, *given * any(hooks))
            # By name (runs,).
            values = {name: np.ravel(x) for name, x in jax.device_get(metrics).items()}
            done += 1
            due = loop.checkpoint_is_due
            if done == first + 1:  # it has compiled, which `minutes` do not count
                begun, at_begin = loop.seconds, count_steps(state)
            seconds, leaving, due = hosts.largest(
                used + loop.seconds - begun, loop.stopping, due
            )
            progress = float(config.progress(done, seconds))
            if config.minutes:
                state = learner.set_seconds(state, seconds)
            steps, updates = count_steps(state), done - first - 1
            rates = (steps - at_begin) / max(loop.seconds - begun, 1e-9)
            in_a_row = np.where(values["skipped"] > skipped, in_a_row + 1, 0)
            skipped = values["skipped"]
            diverged |= in_a_row >= MAX_SKIPPED
            going = [k for k in range(count) if not diverged[k]]
            for k in going:
                row: dict[str, float] = {"update": done, "env_steps": int(steps[k])}
                row |= {"seconds": loop.seconds, "steps_per_second": float(rates[k])}
                row |= {name: float(x[k]) for name, x in values.items()}
                if logs:
                    logs[k].write(row)
                asked |= callback is not None and callback(k, row)
                asked |= any([hook.after(row) is True for hook in hooks[k]])
            if callback is not None or any(hooks):
                leaving = hosts.largest(asked or leaving)[0]
            pace = f"{rates.sum():>7,.0f} steps/s  " if updates else ""
            loop.show(
                progress,
                f"{steps.sum() / 1e6:.2f} M  {pace}"
                f"[green]parked {values['episode/parked'].mean():5.1%}[/]  "
                f"[red]crashed {values['episode/crashed'].mean():5.1%}[/]",
            )
            if due or leaving or progress >= 1.0:
                states = learner.split(learner.gather(state))
                hosts.on_first(
                    lambda states=states, going=going: [
                        save(folders[k], learner.configs[k], states[k]) for k in going
                    ]
                )
                loop.saved()
    ended: Outcome = "done" if progress >= 1.0 else "stopped"
    return ["diverged" if failed else ended for failed in diverged]


def announcement(config: PPOConfig, update: int, seconds: float) -> str:
    """What a run is going to do, after the updates and seconds that it continues."""
    left = max(config.num_steps - update * config.steps_per_update, 0) / 1e6
    budget = f"{left:.3g} M steps"
    if config.minutes:
        minutes = max(config.minutes - seconds / 60.0, 0.0)
        budget = f"at most {minutes:.3g} min or {budget}"
    words = f"compiles, then trains for {budget}"
    if config.progress(update, seconds) >= 1.0:
        words = "has nothing left to train"
    after = ["evaluates"] * bool(config.eval_episodes)
    after += ["renders"] * bool(config.video_seconds)
    return f"{words}, then {' and '.join(after)}" if after else words


def load_or_init(learner: Learner, folders: Sequence[Path]) -> TrainingState:
    """The newest checkpoints of the runs, or a fresh state if they have none."""
    if not any(runs.checkpoint_files(folder) for folder in folders):
        state = learner.init()
        if not any(config.warm_start for config in learner.configs):
            return state
        states = zip(learner.configs, learner.split(learner.gather(state)), strict=True)
        begun = [warm_start(c, s) if c.warm_start else s for c, s in states]
        return learner.place(learner.join(begun))
    template = vars(jax.eval_shape(lambda x: learner.split(x)[0], learner.shapes()))
    found: list[TrainingState] = []
    newest = [runs.latest_checkpoint(folder) for folder in folders]
    # The last step that all have saved: a kill may come between two of a step.
    name = min(path.name for path in newest)
    for folder, path in zip(folders, newest, strict=True):
        if not (path := path.with_name(name)).exists():
            raise CheckpointError(
                f"{folder} has no checkpoint {name}, where another run stands: "
                "resume them one by one"
            )
        read_header(path, PPOConfig)
        found.append(TrainingState(**checkpoints.load(path, template)))
    return learner.place(learner.join(found))


def save(folder: Path, config: PPOConfig, state: TrainingState) -> Path:
    """Writes a checkpoint of the state, which is in the host's memory."""
    update, steps = int(state.update), int(count_steps(state)[0])
    settings = dataclasses.asdict(config)
    header = {"config": settings, "update": update, "env_steps": steps}
    # Its name counts the steps of absent agents too, equal for runs side by side.
    slots = update * config.slots_per_update
    return runs.save_checkpoint(folder, vars(state), header, slots)
