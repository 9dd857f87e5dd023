"""Times compiled programs."""

import time
from collections.abc import Callable
from typing import Any

import jax

# What is called a second: of the wall clock, or of all threads of this process, which
# other work on the machine disturbs far less.
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


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
