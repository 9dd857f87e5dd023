"""Outcomes of the runs of a sweep: one small file for each, and one table of all.

runs/SWEEP/
    sweep.json          what all runs have in common
    sweep.csv           a row per run
    outcomes/RUN.json   that it is done, or why it failed
    runs/RUN/           the run's own folder, as `carpark_mj train` leaves it
    logs/               what jobs print
"""

import contextlib
import dataclasses
import fcntl
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from carpark_mj.analysis.runs import read_run
from carpark_mj.files import write_csv, write_json
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.runs import from_dict
from carpark_mj.reading import read_csv, read_object
from carpark_mj.sweeps.plan import Plan, Run

TABLE = "sweep.csv"

Status = Literal["done", "stopped", "failed", "waiting"]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Outcome of a run.

    Attributes:
        status: `done`; `stopped` before its end, to be resumed; `failed`; or `waiting`,
            not known yet.
        error: reason of the failure, one sentence.
        seconds: duration of the last attempt.
    """

    status: Status
    error: str = ""
    seconds: float = 0.0


def run_folder(sweep: Path, run: Run) -> Path:
    """Where a run trains."""
    return sweep / "runs" / run.name


def open_sweep(folder: Path, plan: Plan, stochastic: bool) -> None:
    """Makes the folder of a sweep, or checks that it holds runs of the same kind.

    Raises:
        ValueError: it holds another sweep.
        OSError: it cannot be written.
    """
    definition = {**plan.definition, "stochastic": stochastic}
    path = folder / "sweep.json"
    if path.exists():
        known = read_object(path)
        if known != definition:
            differing = [k for k, v in definition.items() if known.get(k) != v]
            raise ValueError(
                f"{folder} holds another sweep, with another {', '.join(differing)}: "
                "choose another --name"
            )
        return
    for part in ("outcomes", "runs", "logs"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    write_json(path, definition)


def read_outcome(sweep: Path, run: Run) -> Outcome:
    """The recorded outcome of a run."""
    try:
        return from_dict(Outcome, read_object(_path(sweep, run)))
    except (FileNotFoundError, ValueError, TypeError):
        return Outcome("waiting")


def remove_outcome(sweep: Path, run: Run) -> None:
    """Removes the outcome of the last attempt before the next."""
    _path(sweep, run).unlink(missing_ok=True)


def write_outcome(sweep: Path, run: Run, outcome: Outcome) -> None:
    """Records the outcome of a run."""
    write_json(_path(sweep, run), dataclasses.asdict(outcome))


@contextlib.contextmanager
def locked(sweep: Path, run: Run) -> Generator[None]:
    """Holds a run alone; waits while another process works on it.

    A sweep that was killed may have left a job that still trains.
    """
    with _path(sweep, run).with_suffix(".lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def write_table(sweep: Path, runs: Sequence[Run]) -> Path:
    """Writes a row per run: settings, seed, status, metrics, versions.

    Rows of runs that were trained before, with other values or seeds, stay.
    """
    names = {run.name for run in runs}
    rows = [row for row in _known_rows(sweep) if row.get("run") not in names]
    rows += [_row(sweep, run) for run in runs]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    # Columns that some runs lack stand behind those that all have, and are empty there.
    write_csv(
        sweep / TABLE, [{name: row.get(name, "") for name in columns} for row in rows]
    )
    return sweep / TABLE


def _known_rows(sweep: Path) -> list[dict[str, Any]]:
    """Rows of the table as it is."""
    try:
        return [{**row.cells} for row in read_csv(sweep / TABLE)]
    except FileNotFoundError:
        return []


def _row(sweep: Path, run: Run) -> dict[str, Any]:
    outcome = read_outcome(sweep, run)
    row: dict[str, Any] = {"run": run.name, "base": run.base, **dict(run.settings)}
    row |= {"seed": run.seed, **dataclasses.asdict(outcome)}
    if outcome.status != "done":
        return row
    with contextlib.suppress(CheckpointError):
        found = read_run(run_folder(sweep, run))
        row |= found.metrics
        row |= {"device": found.device, **_prefixed("version", found.versions)}
    return row


def _prefixed(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{prefix}_{name}": value for name, value in values.items()}


def _path(sweep: Path, run: Run) -> Path:
    return sweep / "outcomes" / f"{run.name}.json"
