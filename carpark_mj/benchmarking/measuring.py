"""What measurements share: processes of their own, clocks, the best of some calls."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import jax

# What is called a second: of the wall clock, or of all threads of this process, which
# other work on the machine disturbs far less.
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


class WorkerError(Exception):
    """A measurement failed, possibly out of memory."""


def run_worker(
    program: str, request: dict[str, Any], environment: dict[str, str], about: str
) -> dict[str, Any]:
    """The object that a Python program prints last, in a fresh process.

    Args:
        program: its argument is the request as JSON.
        request: what to measure.
        environment: variables of the process.
        about: what is measured, for messages.

    Raises:
        ValueError: the process refused the request (exit code 2).
        WorkerError: it failed.
    """
    done = subprocess.run(
        [sys.executable, "-c", program, json.dumps(request)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return json.loads(done.stdout.splitlines()[-1])
    message = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    if done.returncode == 2:
        raise ValueError(message[0])
    if done.returncode == -signal.SIGINT:  # the process was interrupted first
        raise KeyboardInterrupt
    if done.returncode < 0:  # its stderr does not explain the signal
        message = [f"killed by signal {-done.returncode}, possibly out of memory"]
    raise WorkerError(f"could not measure {about}: {message[0]}")


def best_time(
    call: Callable[[], Any],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Seconds of the fastest of some calls, each until its results are computed."""
    best = float("inf")
    for _ in range(repeats):
        begun = clock()
        jax.block_until_ready(call())
        best = min(best, clock() - begun)
    return best
