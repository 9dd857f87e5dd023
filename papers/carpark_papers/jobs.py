"""Runs of a trainer side by side, each in its own process and on its own core."""

import dataclasses
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent import futures
from pathlib import Path

from carpark_mj.cli.process import patient_interrupts
from carpark_mj.config.checks import CheckedConfig, Count, Natural, NonNegative
from carpark_mj.files import require_writable

LEAST = 1.0  # min that must be left for a run to begin
POLL = 0.1  # s between looks at the runs
# One core each: libraries that would start a thread for every core of the machine.
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def is_evaluated(folder: Path) -> bool:
    """Whether a trainer that evaluates at the end only has evaluated."""
    return (folder / "evaluation.json").exists()


@dataclasses.dataclass(frozen=True)
class Job:
    """A training with a seed; experiments with equal trainings share it."""

    program: str  # of `carpark_mj study`, which trains
    folder: Path  # of the run
    flags: tuple[str, ...]  # of the program, for a new run
    # whether the run in a folder is finished
    finished: Callable[[Path], bool] = is_evaluated

    @property
    def is_done(self) -> bool:
        """Whether the run is finished."""
        return self.finished(self.folder)

    @property
    def log(self) -> Path:
        """File with the output of the run."""
        return self.folder.with_name(f"{self.folder.name}.log")

    def command(self, minutes: float) -> list[str]:
        """Begins or continues the run, for some minutes at most; 0 = no limit."""
        limit = ["--time-limit", f"{minutes:.2f}"]
        flags: Sequence[str] = self.flags
        if (self.folder / "config.json").exists():
            flags = "--resume", str(self.folder)
        command = sys.executable, "-m", "carpark_mj", "study", self.program
        return [*command, *flags, *limit]


def run_jobs(
    jobs: Sequence[Job],
    workers: int,
    minutes: float,
    clock: Callable[[], float] = time.monotonic,
) -> list[Job]:
    """Runs unfinished jobs; returns the failed ones.

    After Ctrl-C, which the runs receive too, no other job begins; once the runs have
    saved and stopped it raises KeyboardInterrupt.

    Args:
        jobs: in the order in which they begin.
        workers: processes at a time, each on a core; 0 = one for every core.
        minutes: after which runs save and stop, to be continued; 0 = no limit.
        clock: gives the time [s].
    """
    cores = sorted(os.sched_getaffinity(0))
    cores = cores[: workers or len(cores)]
    free: queue.SimpleQueue[int] = queue.SimpleQueue()
    for core in cores:
        free.put(core)
    begun, interrupted = clock(), threading.Event()

    def work(job: Job) -> int:
        left = minutes - (clock() - begun) / 60 if minutes else 0.0
        if interrupted.is_set() or (minutes and left < LEAST):
            return 0
        core = free.get()
        code = _run(job, core, left)
        free.put(core)
        print(f"{job.folder.name}: {_outcome(job, code)}", flush=True)
        return code

    with futures.ThreadPoolExecutor(len(cores)) as pool, patient_interrupts():
        codes = [pool.submit(work, job) for job in jobs]
        try:
            while futures.wait(codes, POLL).not_done:
                pass
        except KeyboardInterrupt:
            interrupted.set()
            futures.wait(codes)
            raise
    return [job for job, code in zip(jobs, codes, strict=True) if code.result()]


@dataclasses.dataclass(frozen=True)
class RepeatConfig(CheckedConfig):
    """Settings of a program that repeats the trainings of a paper over seeds.

    Attributes:
        all: all of them.
        list: list them and train none.
        seeds: runs of every training.
        minutes: time after which runs save and stop [min], more than 1; 0 = no limit.
        workers: number of runs at a time, each on one core; 0 = one for every core.
        runs_dir: folder of the runs.
    """

    all: bool = False
    list: bool = False
    seeds: Count = 5
    minutes: NonNegative = 0.0
    workers: Natural = 0
    runs_dir: str = "runs"

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.minutes <= LEAST:
            raise ValueError(
                f"minutes must be more than {LEAST:g} (shorter runs do not begin), or "
                f"0 = no limit, not {self.minutes}"
            )

    def repeat(self, jobs: Sequence[Job], report: Callable[[], Path]) -> int:
        """Runs what is not finished, then reports; the exit code, 1 if runs failed."""
        left = [job for job in jobs if not job.is_done]
        print(f"{len(jobs)} runs, {len(jobs) - len(left)} of them done", flush=True)
        folder = Path(self.runs_dir)
        folder.mkdir(parents=True, exist_ok=True)
        require_writable(folder / "report.md")  # refused before the work
        failed = run_jobs(left, self.workers, self.minutes)
        print(f"wrote {report()}")
        return 1 if failed else 0


def _run(job: Job, core: int, minutes: float) -> int:
    job.folder.parent.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, **dict.fromkeys(_THREADS, "1")}
    with job.log.open("a") as log:
        process = subprocess.Popen(
            job.command(minutes), stdout=log, stderr=log, env=environment
        )
        os.sched_setaffinity(process.pid, {core})
        return process.wait()


def _outcome(job: Job, code: int) -> str:
    if code:
        return f"failed with exit code {code}, see {job.log}"
    return "done" if job.is_done else "stopped, to be continued"
