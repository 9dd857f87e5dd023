"""Jobs of a Slurm cluster: what they ask for, and which are in the queue."""

import dataclasses
import subprocess
from collections.abc import Sequence
from typing import Any

import submitit
from submitit.core.utils import FailedJobError

from carpark_mj.config.checks import CheckedConfig, Count, Natural, NonNegative
from carpark_mj.files import write_json
from carpark_mj.reading import read_object
from carpark_mj.sweeps.environment import import_path
from carpark_mj.sweeps.plan import Run
from carpark_mj.sweeps.work import Work


@dataclasses.dataclass(frozen=True)
class SlurmConfig(CheckedConfig):
    """What is asked of Slurm for every run.

    Attributes:
        partition: where; empty = the cluster's default.
        account: that pays; empty = the user's own.
        qos: quality of service; empty = the default.
        constraint: features that nodes must have.
        time: after which a job is queued again, to go on from its checkpoint [min].
        requeues: how often it may be.
        gpus_per_node: number of GPUs.
        cpus_per_task: number of CPU cores.
        mem_gb: memory [GB]; 0 = the default.
    """

    partition: str = ""
    account: str = ""
    qos: str = ""
    constraint: str = ""
    time: Count = 240
    requeues: Natural = 10
    gpus_per_node: Natural = 1
    cpus_per_task: Count = 4
    mem_gb: NonNegative = 0.0

    @property
    def parameters(self) -> dict[str, Any]:
        """By submitit's names; what is not given is left out."""
        names = ("partition", "account", "qos", "constraint")
        asked: dict[str, Any] = {f"slurm_{name}": getattr(self, name) for name in names}
        asked |= {"gpus_per_node": self.gpus_per_node, "mem_gb": self.mem_gb}
        given = {name: value for name, value in asked.items() if value}
        return given | {"timeout_min": self.time, "cpus_per_task": self.cpus_per_task}


def submit_all(
    executor: submitit.AutoExecutor, works: Sequence[Work]
) -> list[tuple[Work, submitit.Job[None]]]:
    """Submits to a cluster what does not stand in its queue from an earlier time.

    Raises:
        ValueError: Slurm refuses the jobs; the message says why.
    """
    if not works:
        return []
    record = works[0].sweep / "logs" / "jobs.json"
    known: dict[str, str] = read_object(record) if record.exists() else {}
    queued = queued_jobs() or set()
    old: dict[str, list[Run]] = {}
    new: list[Work] = []
    for work in works:
        left: list[Run] = []
        for run in work.runs:
            job_id = known.get(run.name, "")
            (old.setdefault(job_id, []) if job_id in queued else left).append(run)
        if left:
            new.append(dataclasses.replace(work, runs=tuple(left)))
    jobs: list[submitit.Job[None]] = []
    if new:
        try:
            with import_path(), executor.batch():
                jobs = [executor.submit(work) for work in new]
        except FailedJobError as error:
            reason = str(error).strip().partition("\n")[0]
            raise ValueError(f"Slurm refuses the jobs: {reason}") from None
    submitted = list(zip(new, jobs, strict=True))
    ids = {run.name: job.job_id for work, job in submitted for run in work.runs}
    write_json(record, known | ids)
    attached = [
        (
            dataclasses.replace(works[0], runs=tuple(members)),
            submitit.SlurmJob[None](executor.folder, job_id),
        )
        for job_id, members in old.items()
    ]
    return [*attached, *submitted]


def queued_jobs() -> set[str] | None:
    """Numbers of the jobs in Slurm's queue; None if it does not answer."""
    command = ["squeue", "--noheader", "--array", "--format", "%i"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return {*said.stdout.split()}
