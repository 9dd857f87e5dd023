"""A job of a sweep: it trains some runs side by side.

What starts MuJoCo is imported when the job runs, in its own process.
"""

import contextlib
import dataclasses
import os
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from carpark_mj.sweeps.outcomes import (
    Outcome,
    Status,
    locked,
    read_outcome,
    write_outcome,
)
from carpark_mj.sweeps.plan import Run

# `(run, status, error)`, as soon as a run ends.
Tell = Callable[[Run, Status, str], None]
# `(runs, folder of the sweep, sampled actions, tell)`.
Train = Callable[[list[Run], Path, bool, Tell], None]


@dataclasses.dataclass(frozen=True)
class Work:
    """A job, as submitit pickles it.

    Attributes:
        sweep: folder of the sweep.
        runs: what to train.
        train: how.
        stochastic: evaluate sampled actions instead of the most likely ones.
        gpus: `CUDA_VISIBLE_DEVICES` of the job, which submitit empties for local ones;
            () = all there are, None = as it is, on a cluster.
        own_process: whether JAX is still to be set up.
    """

    sweep: Path
    runs: tuple[Run, ...]
    train: Train
    stochastic: bool = False
    gpus: tuple[str, ...] | None = None
    own_process: bool = True

    def __call__(self) -> None:
        """Trains what is left of the runs, and writes what becomes of each."""
        if self.gpus:
            os.environ["CUDA_VISIBLE_DEVICES"] = ",".join(self.gpus)
        elif self.gpus is not None:
            os.environ.pop("CUDA_VISIBLE_DEVICES", None)
        if self.own_process:
            set_up_jax()
        with contextlib.ExitStack() as stack:
            # In one order, so that two jobs never wait for each other.
            for run in sorted(self.runs, key=lambda run: run.name):
                stack.enter_context(locked(self.sweep, run))
            left = {
                r for r in self.runs if read_outcome(self.sweep, r).status != "done"
            }
            self._train([run for run in self.runs if run in left])

    def checkpoint(self) -> Any:
        """Before the end of its time on a cluster: the job is queued again."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)

    def _train(self, left: list[Run]) -> None:
        begun = time.monotonic()
        told: set[Run] = set()

        def tell(run: Run, status: Status, error: str = "") -> None:
            seconds = (time.monotonic() - begun) / len(left)
            write_outcome(self.sweep, run, Outcome(status, error, seconds))
            told.add(run)

        try:
            if left:
                self.train(left, self.sweep, self.stochastic, tell)
        except Exception as error:  # of any kind: the other jobs go on
            for run in left:
                if run not in told:
                    tell(run, "failed", describe(error))


def describe(error: Exception) -> str:
    """An error as one sentence; all of it stands in the job's log."""
    from carpark_mj.cli.common import one_line

    traceback.print_exception(error)
    return one_line(error) or type(error).__name__


def set_up_jax() -> None:
    """What `carpark_mj train` does before it trains."""
    from carpark_mj.cli.common import configure_jax, keep_compiled_programs
    from carpark_mj.rendering.gl import choose_gl

    choose_gl()
    configure_jax()
    keep_compiled_programs()


def prepare(cluster: str) -> None:
    """Sets JAX up; a process that only submits leaves the GPU to its jobs."""
    if cluster == "debug":
        set_up_jax()
    else:
        import jax

        from carpark_mj.cli.common import enable_output_fusion

        enable_output_fusion()
        jax.config.update("jax_platforms", "cpu")
