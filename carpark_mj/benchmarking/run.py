"""Runs jobs, each in its own process; checkouts take turns."""

import dataclasses
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.benchmarking.checkouts import Checkout, worker_of
from carpark_mj.benchmarking.records import Job, Measurement
from carpark_mj.benchmarking.report import Row, write_csv


class WorkerError(Exception):
    """A measurement failed, possibly out of memory."""


def measure(
    jobs: Sequence[Job], measured: Sequence[Checkout], repeats: int, out: str = ""
) -> list[Row]:
    """Measures all jobs in all checkouts in turn; prints progress on stderr.

    Args:
        jobs: of each round.
        measured: checkouts.
        repeats: rounds.
        out: CSV file of all measurements, written after each; empty = none.

    Raises:
        ValueError: impossible settings.
        WorkerError: a process failed.
        OSError: the CSV cannot be written.
    """
    rows: list[Row] = []
    if out:  # refuses an impossible path before anything is measured
        write_csv(Path(out), rows)
    for number in range(1, repeats + 1):
        for job in jobs:
            for checkout in measured:
                result = run_job(job, checkout)
                rows.append(Row(job, checkout, number, result))
                if out:
                    write_csv(Path(out), rows)
                print(
                    f"round {number} of {repeats}, {checkout.name}: "
                    f"{result.what} {result.layout}, {job.lots:,} lots: "
                    f"{result.rate:,.0f} {result.unit}, "
                    f"compiled in {result.compile_s:.1f} s",
                    file=sys.stderr,
                )
    return rows


def run_job(job: Job, checkout: Checkout) -> Measurement:
    """Measures a job in a fresh process with the code of a checkout, its worker too.

    Raises:
        ValueError: settings that the checkout refuses.
        WorkerError: the process failed otherwise.
    """
    request = {
        "job": dataclasses.asdict(job),
        "checkout": str(checkout.path),
        "started": time.time(),
    }
    # -P: not the worker's folder on the path, which could shadow other modules.
    worker = str(worker_of(checkout.path))
    command = [sys.executable, "-P", worker, json.dumps(request)]
    done = subprocess.run(
        command,
        env=worker_environment(checkout.path),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return Measurement(**json.loads(done.stdout.splitlines()[-1]))
    said = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    if done.returncode == 2:
        raise ValueError(said[0])
    if done.returncode < 0:  # its stderr does not explain the signal
        said = [f"killed by signal {-done.returncode}, possibly out of memory"]
    raise WorkerError(
        f"could not measure {job.what} {job.variant} with {job.lots} lots in "
        f"{checkout.name}: {said[0]}"
    )


def worker_environment(checkout: Path) -> dict[str, str]:
    """Environment variables: the checkout's code first, no compiled programs kept."""
    environment = dict(os.environ)
    inherited = environment.get("PYTHONPATH", "")
    own = checkout, checkout / "train", checkout / "eval"
    paths = [*map(str, own), *([inherited] if inherited else [])]
    environment["PYTHONPATH"] = os.pathsep.join(paths)
    environment["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    return environment
