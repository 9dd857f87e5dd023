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
import json
import os
import shutil
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from carpark_mj.config.checks import counted
from carpark_mj.rendering.gl import choose_gl

choose_gl()  # before anything imports MuJoCo; jobs import this module first

import jax
import submitit
from rich.console import Console
from submitit.core.utils import FailedJobError
from submitit.helpers import DelayedSubmission

from carpark_mj.analysis import read_run
from carpark_mj.cli.process import configure_jax, enable_output_fusion, one_line
from carpark_mj.cli.settings.tables import SweepConfig, Where
from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.compilation import keep_compiled_programs
from carpark_mj.files import write_csv, write_json
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.runs import checkpoint_files
from carpark_mj.reading import read_csv, read_object
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
from carpark_mj.training.run_folder import read_config

POLL_SECONDS = {"local": 0.5, "debug": 0.0, "slurm": 10.0}
ENDLESS = 10 * 365 * 24 * 60  # of a local job, which submitit would end [min]
# Asked for if not given.
SLURM = ("timeout_min=240", "gpus_per_node=1", "cpus_per_task=4")
REQUEUES = 10  # times that Slurm queues a job again at its time limit
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
    write_csv(path, rows)
    return path


# `(run, status, error)`, as soon as a run ends.
Report = Callable[[Run, Status, str], None]
# `(runs, folder of the sweep, sampled actions, report)`.
Train = Callable[[list[Run], Path, bool, Report], None]


def train_ppo(runs: list[Run], sweep: Path, stochastic: bool, report: Report) -> None:
    """Trains runs side by side, from their last checkpoints on, and evaluates them."""
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
            config, changes = read_config(PPOConfig, folder), {"resume": str(folder)}
        else:
            shutil.rmtree(folder, ignore_errors=True)  # killed before its first
            config = settings_of(run)
            changes = {"name": run.name, "runs_dir": str(folder.parent)}
        config = dataclasses.replace(config, **changes)
        parts.setdefault(files[-1].name if files else "", []).append(config)
    diverged = f"{MAX_SKIPPED} updates in a row were non-finite"
    for configs in parts.values():
        ended = train_runs(configs, finish_run)
        for folder, outcome in ended:
            if outcome == "stopped":
                report(by_folder[folder], "stopped", "")
            elif outcome == "diverged":
                report(by_folder[folder], "failed", diverged)
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


def _value(text: str) -> Any:
    """What a text is in JSON, or the text."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def make_executor(where: Where, folder: Path) -> submitit.AutoExecutor:
    """The executor of a cluster; `folder` is for what jobs print."""
    asked: dict[str, Any] = {"timeout_min": ENDLESS}
    options: dict[str, Any] = {}
    if where.cluster == "slurm":
        settings = (*SLURM, f"array_parallelism={where.jobs or 1000}", *where.slurm)
        named = [setting.partition("=") for setting in settings]
        asked = {f"slurm_{n.replace('-', '_')}": _value(text) for n, _, text in named}
        options["slurm_max_num_timeout"] = REQUEUES
    try:
        # Jobs may start elsewhere.
        executor = submitit.AutoExecutor(folder.resolve(), where.cluster, **options)
        executor.update_parameters(name=folder.parent.name, **asked)
    except (RuntimeError, NameError, TypeError, ValueError) as error:
        raise ValueError(f"cluster {where.cluster}: {error}") from None
    # Jobs inherit the environment, and import what this process can.
    paths = [str(Path(path).resolve()) for path in sys.path]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    return executor


def run_works(
    executor: submitit.AutoExecutor, works: Sequence[Work], jobs: int
) -> Iterator[tuple[Work, str]]:
    """Runs jobs; yields each as it ends, with the reason if its process failed.

    Left early, by Ctrl-C for instance, it cancels local jobs; cluster jobs continue.
    """
    waiting = list(works)
    running: dict[int, tuple[Work, submitit.Job[None]]] = {}  # by slot
    if executor.cluster == "slurm":
        running = dict(enumerate(submit_array(executor, waiting)))
        waiting = []
    try:
        while waiting or running:
            for slot in {*range(jobs)} - {*running}:
                if waiting:
                    work = waiting.pop(0)
                    if executor.cluster == "local":
                        gpus = visible_gpus(slot, jobs)
                        work = dataclasses.replace(work, gpus=gpus)
                    running[slot] = work, executor.submit(work)
            # A debug job that is asked would run and, if it fails, start a debugger.
            # Submitit's own query of Slurm needs accounting.
            if executor.cluster == "slurm":
                queued = queued_jobs()
                ended = [
                    slot
                    for slot, (_, job) in running.items()
                    if queued is not None and job.job_id not in queued
                ]
            else:
                debug = executor.cluster == "debug"
                ended = [slot for slot, (_, j) in running.items() if debug or j.done()]
            for slot in ended:
                work, job = running.pop(slot)
                yield work, _reason(job)
            if running and not ended:
                time.sleep(POLL_SECONDS[executor.cluster])
    finally:
        if executor.cluster == "local":
            for _, job in running.values():
                job.cancel(check=False)


def visible_gpus(slot: int, jobs: int) -> tuple[str, ...]:
    """GPUs of a local job: of several at a time each has its own, if possible."""
    nodes = sorted(node.name for node in Path("/dev").glob("nvidia[0-9]*"))
    devices = [node.removeprefix("nvidia") for node in nodes]
    if (given := os.environ.get("CUDA_VISIBLE_DEVICES")) is not None:
        devices = given.split(",")
    if jobs > 1 and devices:
        return (devices[slot % len(devices)],)
    return tuple(devices)


def _reason(job: submitit.Job[None]) -> str:
    """Why a job that ended has failed; empty if it has not. A debug job runs now."""
    if isinstance(job, submitit.SlurmJob) and not job.paths.result_pickle.exists():
        return f"its job left the queue without a result (see {job.paths.stderr})"
    try:
        error = job.exception()
    except Exception as raised:
        error = raised
    if error is None:
        return ""
    reason = str(error).strip().partition("\n")[0]
    return f"its process ended: {reason} (see {job.paths.stderr})"


def submit_array(
    executor: submitit.AutoExecutor, works: Sequence[Work]
) -> list[tuple[Work, submitit.Job[None]]]:
    """Submits to a cluster what does not stand in its queue from an earlier time."""
    record = executor.folder / "jobs.json"
    known: dict[str, str] = read_object(record) if record.exists() else {}
    queued = queued_jobs() if known else set[str]()
    while queued is None:  # a job that may be queued is not submitted again
        time.sleep(POLL_SECONDS["slurm"])
        queued = queued_jobs()
    jobs: list[tuple[Work, submitit.Job[None]]] = []
    new: list[Work] = []
    for work in works:
        by_job: dict[str, list[Run]] = {}
        for run in work.runs:
            job_id = known.get(run.name, "")
            by_job.setdefault(job_id * (job_id in queued), []).append(run)
        for job_id, own in by_job.items():
            part = dataclasses.replace(work, runs=tuple(own))
            if job_id:
                jobs.append((part, submitit.SlurmJob[None](executor.folder, job_id)))
            else:
                new.append(part)
    if new:
        try:
            with executor.batch():
                submitted = [executor.submit(work) for work in new]
        except FailedJobError as error:
            reason = str(error).strip().partition("\n")[0]
            raise ValueError(f"Slurm refuses the jobs: {reason}") from None
        jobs += zip(new, submitted, strict=True)
    ids = {run.name: job.job_id for work, job in jobs for run in work.runs}
    write_json(record, known | ids)
    return jobs


def queued_jobs() -> set[str] | None:
    """Numbers of the jobs in Slurm's queue; None if it does not answer now.

    Raises `OSError` if there is no `squeue`.
    """
    command = ["squeue", "--noheader", "--array", "--format", "%i"]
    try:
        asked = subprocess.run(command, capture_output=True, text=True, check=True)
    except subprocess.CalledProcessError:
        return None
    return {*asked.stdout.split()}


def run_sweep(
    folder: Path,
    plan: Plan,
    runs: Sequence[Run],
    where: Where,
    train: Train = train_ppo,
) -> Counter[str]:
    """Trains the unfinished of the checked runs of a plan; counts all by status."""
    executor = make_executor(where, folder / "logs")
    open_sweep(folder, plan, where.stochastic)
    left = [run for run in runs if read_outcome(folder, run).status != "done"]
    say = Console(highlight=False, soft_wrap=True, markup=False).print
    done = len(runs) - len(left)
    say(f"{folder}: {counted(len(runs), 'run')}, {done} done")
    for run in left:
        write_outcome(folder, run, Outcome("waiting"))
    write_table(folder, runs)
    sweep, own_process = folder.resolve(), where.cluster != "debug"
    works = [
        Work(sweep, group, train, where.stochastic, own_process=own_process)
        for group in groups(left, where.side_by_side)
    ]
    for work, reason in run_works(executor, works, where.jobs or 1):
        for run in work.runs:
            outcome = read_outcome(folder, run)
            if outcome.status == "waiting":  # its process was killed
                outcome = Outcome("failed", reason or "its job did not train it")
                write_outcome(folder, run, outcome)
            done += outcome.status == "done"
            after = f" after {outcome.seconds:.0f} s"
            after = f": {outcome.error}" if outcome.status == "failed" else after
            say(f"{done}/{len(runs)} {run.name}: {outcome.status}{after}")
        write_table(folder, runs)
    counts = Counter(read_outcome(folder, run).status for run in runs)
    table = write_table(folder, runs)
    say(f"{', '.join(f'{n} {status}' for status, n in counts.items())}; see {table}")
    return counts


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
    # The rules of a run's name and seeds.
    RunConfig(name=config.name, seed=config.seed)
    RunConfig(seed=config.seed + config.repeats - 1)
    axes = tuple(read_axis(text, PRESETS[config.base]) for text in config.set)
    plan = Plan(config.base, axes, config.repeats, config.seed)
    swept = [x.fields[0].rpartition(".")[2] for x in plan.axes if x.is_swept]
    folder = Path(config.runs_dir) / (config.name or "-".join((config.base, *swept)))
    counts = run_sweep(folder, plan, checked_runs(plan), config)
    return 1 if counts["failed"] else 0
