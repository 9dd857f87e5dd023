"""Sweeps: every combination of some settings is trained, through submitit.

runs/SWEEP/
    sweep.json          what all runs have in common
    sweep.csv           a row per run
    outcomes/RUN.json   that it is done, or why it failed
    runs/RUN/           the run's own folder, as `carpark_mj train` leaves it
    logs/               what jobs print
"""

import contextlib
import dataclasses
import fcntl
import os
import shutil
import time
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, Literal

from carpark_mj.config.checks import counted
from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo; jobs import this module first

import jax
from rich.console import Console
from submitit.helpers import DelayedSubmission

from carpark_mj.analysis import read_run
from carpark_mj.cli.process import (
    configure_jax,
    enable_output_fusion,
    one_line,
)
from carpark_mj.cli.settings.tables import SweepConfig, Where
from carpark_mj.compilation import keep_compiled_programs
from carpark_mj.files import write_csv, write_json
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.runs import checkpoint_files
from carpark_mj.reading import read_csv, read_object
from carpark_mj.sweeps.jobs import make_executor, run_works
from carpark_mj.sweeps.plan import (
    Plan,
    Run,
    checked_runs,
    groups,
    read_axis,
    settings_of,
)
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.run_folder import RunConfig, read_config

Status = Literal["done", "stopped", "failed", "waiting"]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Outcome of a run."""

    status: Status  # `stopped`: to be resumed; `waiting`: not known yet
    error: str = ""  # reason of the failure, one sentence
    seconds: float = 0.0  # duration of the last attempt


def run_folder(sweep: Path, run: Run) -> Path:
    """Where a run trains."""
    return sweep / "runs" / run.name


def open_sweep(folder: Path, plan: Plan, stochastic: bool) -> None:
    """Makes the folder of a sweep, or checks that its runs fit."""
    definition = {**plan.definition, "stochastic": stochastic}
    path = folder / "sweep.json"
    if not path.exists():
        for part in ("outcomes", "runs", "logs"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        write_json(path, definition)
    elif (known := read_object(path)) != definition:
        differing = [k for k, v in definition.items() if known.get(k) != v]
        raise ValueError(
            f"{folder} holds another sweep, with another {', '.join(differing)}: "
            "choose another --name"
        )


def read_outcome(sweep: Path, run: Run) -> Outcome:
    """The recorded outcome of a run."""
    try:
        return Outcome(**read_object(sweep / "outcomes" / f"{run.name}.json"))
    except (FileNotFoundError, ValueError, TypeError):
        return Outcome("waiting")


def write_outcome(sweep: Path, run: Run, outcome: Outcome) -> None:
    """Records the outcome of a run."""
    path = sweep / "outcomes" / f"{run.name}.json"
    write_json(path, dataclasses.asdict(outcome))


@contextlib.contextmanager
def locked(sweep: Path, run: Run) -> Generator[None]:
    """Holds a run alone; waits while another process works on it.

    A sweep that was killed may have left a job that still trains.
    """
    with (sweep / "outcomes" / f"{run.name}.lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def write_table(sweep: Path, runs: Sequence[Run]) -> Path:
    """Writes a row per run: settings, seed, status, metrics, versions.

    Rows of runs that were trained before, with other values or seeds, stay.
    """
    path, names = sweep / "sweep.csv", {run.name for run in runs}
    known = read_csv(path, "run") if path.exists() else []
    rows: list[dict[str, Any]] = [x.cells for x in known if x.cells["run"] not in names]
    for run in runs:
        outcome = read_outcome(sweep, run)
        row = {"run": run.name, "base": run.base, **dict(run.settings)}
        row |= {"seed": run.seed, **dataclasses.asdict(outcome)}
        with contextlib.suppress(CheckpointError):
            if outcome.status == "done":
                found = read_run(run_folder(sweep, run))
                row |= {**found.metrics, "device": found.device}
                row |= {f"version_{k}": v for k, v in found.versions.items()}
        rows.append(row)
    columns = dict.fromkeys(name for row in rows for name in row)
    write_csv(path, [{name: row.get(name, "") for name in columns} for row in rows])
    return path


# `(run, status, error)`, as soon as a run ends.
Report = Callable[[Run, Status, str], None]
# `(runs, folder of the sweep, sampled actions, report)`.
Train = Callable[[list[Run], Path, bool, Report], None]


def train_ppo(runs: list[Run], sweep: Path, stochastic: bool, report: Report) -> None:
    """Trains runs side by side, from their last checkpoints on, and evaluates them.

    Args:
        runs: that can share a program.
        sweep: folder of the sweep.
        stochastic: evaluate sampled actions.
        report: called with the outcome of each run.
    """
    from carpark_mj.training.ppo.train import MAX_SKIPPED, finish, train_runs

    by_folder = {run_folder(sweep, run): run for run in runs}

    def finish_run(config: PPOConfig, folder: Path) -> None:
        try:
            finish(config, folder, stochastic)
        except Exception as error:  # the others are still to be evaluated
            report(by_folder[folder], "failed", _sentence(error))
        else:
            report(by_folder[folder], "done", "")

    # Side by side they go on from one checkpoint: a kill between two checkpoints
    # leaves runs of a group with different ones.
    parts: dict[str, list[PPOConfig]] = {}
    for folder, run in by_folder.items():
        if files := checkpoint_files(folder):
            config = read_config(PPOConfig, folder)
            config = dataclasses.replace(config, resume=str(folder))
        else:
            shutil.rmtree(folder, ignore_errors=True)  # killed before its first
            config = dataclasses.replace(
                settings_of(run), name=run.name, runs_dir=str(folder.parent)
            )
        parts.setdefault(files[-1].name if files else "", []).append(config)
    for configs in parts.values():
        ended = train_runs(configs, finish_run)
        for folder, outcome in ended:
            if outcome == "stopped":
                report(by_folder[folder], "stopped", "")
            elif outcome == "diverged":
                error = f"{MAX_SKIPPED} updates in a row were non-finite"
                report(by_folder[folder], "failed", error)
        if any(outcome == "stopped" for _, outcome in ended):
            return


def _sentence(error: Exception) -> str:
    """An error as one sentence; the traceback goes to the job's log."""
    traceback.print_exception(error)
    return one_line(error) or type(error).__name__


@dataclasses.dataclass(frozen=True)
class Work:
    """A job, as submitit pickles it."""

    sweep: Path  # folder of the sweep
    runs: tuple[Run, ...]
    train: Train
    stochastic: bool = False  # evaluate sampled actions
    # `CUDA_VISIBLE_DEVICES` of the job, which submitit empties for local ones; () = all
    # there are, None = as it is, on a cluster.
    gpus: tuple[str, ...] | None = None
    own_process: bool = True  # whether JAX is still to be set up

    def __call__(self) -> None:
        """Trains the unfinished runs and records the outcome of each."""
        if self.gpus:
            os.environ["CUDA_VISIBLE_DEVICES"] = ",".join(self.gpus)
        elif self.gpus is not None:
            os.environ.pop("CUDA_VISIBLE_DEVICES", None)
        if self.own_process:
            configure_jax()
            keep_compiled_programs()
        with contextlib.ExitStack() as stack:
            # In one order, so that two jobs never wait for each other.
            for run in sorted(self.runs, key=lambda run: run.name):
                stack.enter_context(locked(self.sweep, run))
            self._train()

    def _train(self) -> None:
        left = [r for r in self.runs if read_outcome(self.sweep, r).status != "done"]
        start, reported = time.monotonic(), set[Run]()

        def report(run: Run, status: Status, error: str = "") -> None:
            seconds = (time.monotonic() - start) / len(left)
            write_outcome(self.sweep, run, Outcome(status, error, seconds))
            reported.add(run)

        try:
            if left:
                self.train(left, self.sweep, self.stochastic, report)
        except Exception as error:  # of any kind: the other jobs go on
            for run in left:
                if run not in reported:
                    report(run, "failed", _sentence(error))

    def checkpoint(self) -> DelayedSubmission:
        """Before the end of its time on a cluster: the job is queued again."""
        return DelayedSubmission(self)


def run_sweep(
    folder: Path,
    plan: Plan,
    runs: Sequence[Run],
    where: Where,
    train: Train = train_ppo,
) -> Counter[str]:
    """Trains the unfinished of the checked runs of a plan; others keep their results.

    Returns:
        How many runs are done, stopped, failed.
    """
    executor = make_executor(where, folder / "logs")
    open_sweep(folder, plan, where.stochastic)
    left = [run for run in runs if read_outcome(folder, run).status != "done"]
    say = Console(highlight=False, soft_wrap=True, markup=False).print
    done = len(runs) - len(left)
    say(f"{folder}: {counted(len(runs), 'run')}, {done} done")
    for run in left:
        write_outcome(folder, run, Outcome("waiting"))
    write_table(folder, runs)
    works = [
        Work(
            folder.resolve(),
            group,
            train,
            where.stochastic,
            own_process=where.cluster != "debug",
        )
        for group in groups(left, where.side_by_side)
    ]
    for work, reason in run_works(executor, works, where.jobs or 1):
        for run in work.runs:
            outcome = read_outcome(folder, run)
            if outcome.status == "waiting":  # its process was killed
                outcome = Outcome("failed", reason or "its job did not train it")
                write_outcome(folder, run, outcome)
            done += outcome.status == "done"
            words = f"{outcome.status} after {outcome.seconds:.0f} s"
            if outcome.status == "failed":
                words = f"failed: {outcome.error}"
            say(f"{done}/{len(runs)} {run.name}: {words}")
        write_table(folder, runs)
    counts = Counter(read_outcome(folder, run).status for run in runs)
    table = write_table(folder, runs)
    say(f"{', '.join(f'{n} {status}' for status, n in counts.items())}; see {table}")
    return counts


def make_plan(config: SweepConfig) -> Plan:
    """The runs to train.

    Raises:
        ValueError: impossible settings.
    """
    # The rules of a run's name and seeds.
    RunConfig(name=config.name, seed=config.seed)
    RunConfig(seed=config.seed + config.repeats - 1)
    if config.base not in PRESETS:
        raise ValueError(f"unknown base {config.base!r}; choose from {[*PRESETS]}")
    base = PRESETS[config.base]
    axes = tuple(read_axis(text, base) for text in config.set)
    return Plan(config.base, axes, config.repeats, config.seed)


def sweep_folder(config: SweepConfig, plan: Plan) -> Path:
    """Folder of the sweep."""
    swept = [x.fields[0].rpartition(".")[2] for x in plan.axes if x.is_swept]
    return Path(config.runs_dir) / (config.name or "-".join((config.base, *swept)))


def prepare(cluster: str) -> None:
    """Sets JAX up; a process that only submits leaves the GPU to its jobs."""
    if cluster == "debug":
        configure_jax()
        keep_compiled_programs()
    else:
        enable_output_fusion()
        jax.config.update("jax_platforms", "cpu")


def main(config: SweepConfig) -> int:
    """Runs the sweep; returns the exit code, 1 if runs have failed."""
    prepare(config.cluster)
    plan = make_plan(config)
    counts = run_sweep(sweep_folder(config, plan), plan, checked_runs(plan), config)
    return 1 if counts["failed"] else 0
