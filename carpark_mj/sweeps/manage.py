"""Runs a sweep: unfinished runs, and the table after every run."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from carpark_mj.sweeps.executor import Cluster, make_executor, run_works
from carpark_mj.sweeps.groups import groups
from carpark_mj.sweeps.outcomes import (
    Outcome,
    open_sweep,
    read_outcome,
    remove_outcome,
    write_outcome,
    write_table,
)
from carpark_mj.sweeps.plan import Plan, Run
from carpark_mj.sweeps.slurm import SlurmConfig
from carpark_mj.sweeps.training import train_ppo
from carpark_mj.sweeps.work import Train, Work


@dataclasses.dataclass(frozen=True)
class Where:
    """Where and how a sweep runs.

    Attributes:
        cluster: `local`, `slurm` or `debug`.
        jobs: largest number of jobs at a time; 0 = one on this machine, all on a
            cluster.
        side_by_side: largest number of runs in a job.
        slurm: resources to request from Slurm.
        stochastic: evaluate sampled actions instead of the deterministic policy.
    """

    cluster: Cluster = "local"
    jobs: int = 0
    side_by_side: int = 1
    slurm: SlurmConfig = dataclasses.field(default_factory=SlurmConfig)
    stochastic: bool = False


def run_sweep(
    folder: Path,
    plan: Plan,
    runs: Sequence[Run],
    where: Where,
    train: Train = train_ppo,
) -> Counter[str]:
    """Trains the unfinished runs; the others keep their results.

    Args:
        folder: of the sweep.
        plan: that the runs are of.
        runs: all of them, checked.
        where: to run them.
        train: how they are trained.

    Returns:
        How many runs are done, stopped, failed.

    Raises:
        ValueError: the folder holds another sweep, or there is no such cluster.
        OSError: the folder cannot be written.
    """
    executor = make_executor(
        where.cluster, folder / "logs", where.jobs, where.slurm, folder.name
    )
    open_sweep(folder, plan, where.stochastic)
    left = [run for run in runs if read_outcome(folder, run).status != "done"]
    say = Console(highlight=False, soft_wrap=True, markup=False).print
    done = len(runs) - len(left)
    say(f"{folder}: {len(runs)} runs, {done} of them done")
    write_table(folder, runs)
    for run in left:
        remove_outcome(folder, run)
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
            if outcome.status == "waiting":  # its process had no time to say so
                outcome = Outcome("failed", reason or "its job did not train it")
                write_outcome(folder, run, outcome)
            done += outcome.status == "done"
            say(f"{done}/{len(runs)} {run.name}: {_words(outcome)}")
        write_table(folder, runs)
    counts = Counter(read_outcome(folder, run).status for run in runs)
    table = write_table(folder, runs)
    say(f"{', '.join(f'{n} {status}' for status, n in counts.items())}; see {table}")
    return counts


def _words(outcome: Outcome) -> str:
    if outcome.status == "failed":
        return f"failed: {outcome.error}"
    return f"{outcome.status} after {outcome.seconds:.0f} s"
