"""Jobs of the benchmark, each measured in a process of its own, and their table."""

import csv
import dataclasses
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from carpark_mj.files import write_atomically

What = Literal["env", "ppo", "physics"]
Clock = Literal["wall", "cpu"]


@dataclasses.dataclass(frozen=True)
class Job:
    """The measurement of one process.

    Attributes:
        what: environment steps, whole PPO updates, or the physics alone.
        variant: layout of `env`, preset of `ppo`, tyres or stepper of `physics`.
        lots: simulated at once; for `physics`, cars.
        num_agents: in each lot of `env`; `ppo` and `physics` have their own.
        num_parked_cars: in each lot of `env`.
        steps: control steps per timing; `ppo` times updates instead.
        timings: of which the best counts.
        clock: by which they are taken.
        runs: of `ppo`, side by side in one program.
    """

    what: What
    variant: str
    lots: int
    num_agents: int
    num_parked_cars: int
    steps: int
    timings: int
    clock: Clock
    runs: int = 1


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Results of a process.

    Attributes:
        device: the GPU's name, or the number of CPU cores.
        jax: version.
        mujoco: version.
        what: measured, with the preset and runs of `ppo` or the tyres and substep of
            `physics`.
        layout: of the lots; empty for `physics`.
        agents: in each lot.
        lots: simulated at once.
        rate: units per second of the clock.
        unit: counted unit, per second of which clock.
        compile_s: tracing, lowering and compiling the program [s of the clock].
        first_step_s: from the start of the process to that of the first call [s of the
            clock].
        peak_memory_mb: of the first GPU, or of the process on a CPU [1e6 bytes].
    """

    device: str
    jax: str
    mujoco: str
    what: str
    layout: str
    agents: int
    lots: int
    rate: float
    unit: str
    compile_s: float
    first_step_s: float
    peak_memory_mb: float


# Other work on the machine can only slow a program down: the best round counts.
BEST: dict[str, Callable[[Sequence[float]], float]] = {
    "rate": max,
    "compile_s": min,
    "first_step_s": min,
    "peak_memory_mb": max,
}
_HEAD = (
    "| what | layout | agents | lots | rate | unit | compile [s] | first step [s] | "
    "peak memory [MB] |"
)
_CSV_COLUMNS = ("round", *(field.name for field in dataclasses.fields(Measurement)))

# The measurements of every job, one of each round.
Rounds = dict[Job, list[Measurement]]


class WorkerError(Exception):
    """A measurement failed, possibly out of memory."""


def measure(jobs: Sequence[Job], repeats: int, out: str = "") -> Rounds:
    """Measures all jobs in turn; prints progress on stderr.

    Args:
        jobs: of each round.
        repeats: rounds.
        out: CSV file of all measurements, written after each; empty = none.

    Raises:
        ValueError: impossible settings.
        WorkerError: a process failed.
        OSError: the CSV cannot be written.
    """
    found: Rounds = {job: [] for job in jobs}
    if out:  # refuses an impossible path before anything is measured
        write_csv(Path(out), found)
    for number in range(1, repeats + 1):
        for job in jobs:
            result = run_job(job)
            found[job].append(result)
            if out:
                write_csv(Path(out), found)
            print(
                f"round {number} of {repeats}: {result.what} {result.layout}, "
                f"{job.lots:,} lots: {result.rate:,.0f} {result.unit}, compiled in "
                f"{result.compile_s:.1f} s",
                file=sys.stderr,
            )
    return found


def run_job(job: Job) -> Measurement:
    """Measures a job in a fresh process, without kept compiled programs.

    Raises:
        ValueError: settings that are refused.
        WorkerError: the process failed otherwise.
    """
    request = {"job": dataclasses.asdict(job), "started": time.time()}
    environment = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-m", "carpark_mj.benchmarking.worker", json.dumps(request)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return Measurement(**json.loads(done.stdout.splitlines()[-1]))
    message = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    if done.returncode == 2:
        raise ValueError(message[0])
    if done.returncode == -signal.SIGINT:  # the process was interrupted first
        raise KeyboardInterrupt
    if done.returncode < 0:  # its stderr does not explain the signal
        message = [f"killed by signal {-done.returncode}, possibly out of memory"]
    raise WorkerError(
        f"could not measure {job.what} {job.variant} with {job.lots} lots: {message[0]}"
    )


def markdown(rounds: Rounds) -> str:
    """The table of the best rounds, under a line that names device and versions."""
    about = next(iter(rounds.values()))[0]
    lines = [f"{about.device}, JAX {about.jax}, MuJoCo {about.mujoco}", ""]
    lines += [_HEAD, "|" + "---|" * (_HEAD.count("|") - 1)]
    for results in rounds.values():
        one = results[0]
        best = [f([getattr(r, name) for r in results]) for name, f in BEST.items()]
        rate, *others = best
        cells = [one.what, one.layout, str(one.agents), f"{one.lots:,}"]
        cells += [f"{rate:,.0f}", one.unit, *(f"{number:,.1f}" for number in others)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_csv(path: Path, rounds: Rounds) -> None:
    """Writes every measurement, one a line.

    Raises:
        OSError: `path` cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_CSV_COLUMNS)
    for results in rounds.values():
        for number, result in enumerate(results, start=1):
            writer.writerow([number, *dataclasses.astuple(result)])
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))
