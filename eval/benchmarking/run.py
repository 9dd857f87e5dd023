"""Runs jobs in processes of their own, in one checkout or another."""

import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarking.checkouts import Checkout
from benchmarking.records import Job, Measurement


class WorkerError(Exception):
    """A measurement failed, possibly out of memory."""


def run_job(job: Job, checkout: Checkout) -> Measurement:
    """Measures a job in a fresh process with the code of a checkout.

    Raises:
        ValueError: settings that the checkout refuses.
        WorkerError: the process failed otherwise.
    """
    request = {
        "job": dataclasses.asdict(job),
        "checkout": str(checkout.path),
        "started": time.time(),
    }
    # -P: no script's folder on the path, which could shadow modules of the checkout.
    command = [sys.executable, "-P", "-m", "benchmarking.worker", json.dumps(request)]
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
    own = [checkout, checkout / "train", Path(__file__).resolve().parents[1]]
    inherited = environment.get("PYTHONPATH", "")
    paths = [*map(str, own), *([inherited] if inherited else [])]
    environment["PYTHONPATH"] = os.pathsep.join(paths)
    environment["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    return environment
