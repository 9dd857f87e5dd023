"""How long compiled programs take."""

import time
from collections.abc import Callable
from typing import Any

import jax


def best_time(call: Callable[[], Any], repeats: int) -> float:
    """Seconds of the fastest of some calls, each until its results are computed."""
    best = float("inf")
    for _ in range(repeats):
        begun = time.perf_counter()
        jax.block_until_ready(call())
        best = min(best, time.perf_counter() - begun)
    return best
