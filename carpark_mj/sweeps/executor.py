"""Where the jobs of a sweep run: submitit's executors."""

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import submitit

from carpark_mj.sweeps.environment import import_path, visible_gpus
from carpark_mj.sweeps.slurm import SlurmConfig, queued_jobs, submit_all
from carpark_mj.sweeps.work import Work

Cluster = Literal["local", "debug", "slurm"]

POLL_SECONDS = {"local": 0.5, "debug": 0.0, "slurm": 10.0}
ENDLESS = 10 * 365 * 24 * 60  # of a local job, which submitit would end [min]


def make_executor(
    cluster: Cluster, folder: Path, jobs: int, slurm: SlurmConfig, name: str
) -> submitit.AutoExecutor:
    """The executor of a cluster.

    Args:
        cluster: `local`: processes of this machine; `debug`: this process, one run
            after the other; `slurm`.
        folder: for what jobs print, and submitit's own files.
        jobs: of Slurm, most at a time; 0 = any number.
        slurm: resources to request.
        name: of the jobs.

    Raises:
        ValueError: there is no such cluster here.
    """
    folder = folder.resolve()  # jobs may start elsewhere
    options = {"slurm_max_num_timeout": slurm.requeues} if cluster == "slurm" else {}
    try:
        executor = submitit.AutoExecutor(folder, cluster=cluster, **options)
    except RuntimeError as error:
        raise ValueError(f"cluster {cluster} is not available: {error}") from None
    executor.update_parameters(name=name)
    if cluster == "slurm":
        executor.update_parameters(
            slurm_array_parallelism=jobs or 1000, **slurm.parameters
        )
    else:
        executor.update_parameters(timeout_min=ENDLESS)
    return executor


def run_works(
    executor: submitit.AutoExecutor, works: Sequence[Work], jobs: int
) -> Iterator[tuple[Work, str]]:
    """Runs jobs; yields each as it ends, with the reason if its process failed.

    Left early, by Ctrl-C for instance, it cancels local jobs; cluster jobs continue.

    Args:
        executor: where.
        works: the jobs.
        jobs: largest number at a time on this machine; a cluster gets all at once.
    """
    waiting = list(works)
    running: dict[int, tuple[Work, submitit.Job[None]]] = {}  # by slot
    if executor.cluster == "slurm":
        running = dict(enumerate(submit_all(executor, waiting)))
        waiting = []
    try:
        while waiting or running:
            for slot in {*range(jobs)} - {*running} if waiting else ():
                if waiting:
                    work = waiting.pop(0)
                    running[slot] = (
                        work,
                        _submit(executor, work, visible_gpus(slot, jobs)),
                    )
            ended = _ended({slot: job for slot, (_, job) in running.items()})
            for slot in ended:
                work, job = running.pop(slot)
                yield work, _reason(job)
            if running and not ended:
                time.sleep(POLL_SECONDS[executor.cluster])
    finally:
        if executor.cluster == "local":
            for _, job in running.values():
                job.cancel(check=False)


def _submit(
    executor: submitit.AutoExecutor, work: Work, gpus: tuple[str, ...]
) -> submitit.Job[None]:
    """Starts a job on this machine."""
    if executor.cluster == "local":
        work = dataclasses.replace(work, gpus=gpus)
    with import_path():
        return executor.submit(work)


def _ended(running: Mapping[int, submitit.Job[None]]) -> list[int]:
    """Which jobs have ended.

    It reads Slurm's queue; submitit's own query needs accounting.
    """
    if any(isinstance(job, submitit.SlurmJob) for job in running.values()):
        queued = queued_jobs()
        if queued is None:
            return []
        return [slot for slot, job in running.items() if job.job_id not in queued]
    # A debug job that is asked would run and, if it fails, start a debugger.
    return [
        slot
        for slot, job in running.items()
        if isinstance(job, submitit.DebugJob) or job.done()
    ]


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
