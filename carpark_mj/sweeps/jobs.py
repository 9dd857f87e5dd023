"""Jobs of sweeps: processes of this machine or of a Slurm cluster, by submitit."""

import dataclasses
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import submitit
from submitit.core.utils import FailedJobError

from carpark_mj.cli.settings.tables import Where
from carpark_mj.files import write_json
from carpark_mj.reading import read_object

if TYPE_CHECKING:
    from carpark_mj.sweeps import Work
    from carpark_mj.sweeps.plan import Run

POLL_SECONDS = {"local": 0.5, "debug": 0.0, "slurm": 10.0}
ENDLESS = 10 * 365 * 24 * 60  # of a local job, which submitit would end [min]


def make_executor(where: Where, folder: Path) -> submitit.AutoExecutor:
    """The executor of a cluster; `folder` is for what jobs print."""
    asked: dict[str, Any] = {"timeout_min": ENDLESS}
    options: dict[str, Any] = {}
    if where.cluster == "slurm":
        slurm = where.slurm
        options = {"slurm_max_num_timeout": slurm.requeues}
        asked = {
            "slurm_array_parallelism": where.jobs or 1000,
            "timeout_min": slurm.time,
            "gpus_per_node": slurm.gpus_per_node,
            "cpus_per_task": slurm.cpus_per_task,
            "mem_gb": slurm.mem_gb,
        }
        for name in ("partition", "account", "qos", "constraint"):
            asked[f"slurm_{name}"] = getattr(slurm, name)
    try:
        # Jobs may start elsewhere.
        executor = submitit.AutoExecutor(folder.resolve(), where.cluster, **options)
    except RuntimeError as error:
        raise ValueError(f"cluster {where.cluster} is not available: {error}") from None
    given = {name: value for name, value in asked.items() if value}
    executor.update_parameters(name=folder.parent.name, **given)
    # Jobs inherit the environment, and import what this process can.
    paths = [str(Path(path).resolve()) for path in sys.path]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    return executor


def run_works(
    executor: submitit.AutoExecutor, works: Sequence["Work"], jobs: int
) -> Iterator[tuple["Work", str]]:
    """Runs jobs; yields each as it ends, with the reason if its process failed.

    Left early, by Ctrl-C for instance, it cancels local jobs; cluster jobs continue.
    """
    waiting = list(works)
    running: dict[int, tuple[Work, submitit.Job[None]]] = {}  # by slot
    if executor.cluster == "slurm":
        running = dict(enumerate(submit_array(executor, waiting)))
        waiting = []
    try:
        while waiting or running:
            for slot in {*range(jobs)} - {*running}:
                if waiting:
                    work = waiting.pop(0)
                    if executor.cluster == "local":
                        gpus = visible_gpus(slot, jobs)
                        work = dataclasses.replace(work, gpus=gpus)
                    running[slot] = work, executor.submit(work)
            # A debug job that is asked would run and, if it fails, start a debugger.
            # Submitit's own query of Slurm needs accounting.
            if executor.cluster == "slurm":
                queued = queued_jobs()
                ended = [
                    slot
                    for slot, (_, job) in running.items()
                    if queued is not None and job.job_id not in queued
                ]
            else:
                debug = executor.cluster == "debug"
                ended = [slot for slot, (_, j) in running.items() if debug or j.done()]
            for slot in ended:
                work, job = running.pop(slot)
                yield work, _reason(job)
            if running and not ended:
                time.sleep(POLL_SECONDS[executor.cluster])
    finally:
        if executor.cluster == "local":
            for _, job in running.values():
                job.cancel(check=False)


def visible_gpus(slot: int, jobs: int) -> tuple[str, ...]:
    """GPUs of a local job: of several at a time each has its own, if possible."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES")
    nodes = sorted(node.name for node in Path("/dev").glob("nvidia[0-9]*"))
    devices = [node.removeprefix("nvidia") for node in nodes]
    if given is not None:
        devices = given.split(",")
    if jobs > 1 and devices:
        return (devices[slot % len(devices)],)
    return tuple(devices)


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


def submit_array(
    executor: submitit.AutoExecutor, works: Sequence["Work"]
) -> list[tuple["Work", submitit.Job[None]]]:
    """Submits to a cluster what does not stand in its queue from an earlier time."""
    record = executor.folder / "jobs.json"
    known: dict[str, str] = read_object(record) if record.exists() else {}
    queued = queued_jobs() if known else set[str]()
    while queued is None:  # a job that may be queued is not submitted again
        time.sleep(POLL_SECONDS["slurm"])
        queued = queued_jobs()
    jobs: list[tuple[Work, submitit.Job[None]]] = []
    new: list[Work] = []
    for work in works:
        by_job: dict[str, list[Run]] = {}
        for run in work.runs:
            job_id = known.get(run.name, "")
            by_job.setdefault(job_id * (job_id in queued), []).append(run)
        for job_id, own in by_job.items():
            part = dataclasses.replace(work, runs=tuple(own))
            if job_id:
                jobs.append((part, submitit.SlurmJob[None](executor.folder, job_id)))
            else:
                new.append(part)
    if new:
        try:
            with executor.batch():
                submitted = [executor.submit(work) for work in new]
        except FailedJobError as error:
            reason = str(error).strip().partition("\n")[0]
            raise ValueError(f"Slurm refuses the jobs: {reason}") from None
        jobs += zip(new, submitted, strict=True)
    ids = {run.name: job.job_id for work, job in jobs for run in work.runs}
    write_json(record, known | ids)
    return jobs


def queued_jobs() -> set[str] | None:
    """Numbers of the jobs in Slurm's queue; None if it does not answer now.

    Raises `OSError` if there is no `squeue`.
    """
    command = ["squeue", "--noheader", "--array", "--format", "%i"]
    try:
        asked = subprocess.run(command, capture_output=True, text=True, check=True)
    except subprocess.CalledProcessError:
        return None
    return {*asked.stdout.split()}
