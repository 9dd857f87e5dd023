"""Log of a PPO run: `metrics.csv` and TensorBoard."""

import csv
import math
from pathlib import Path
from typing import Any

from tensorboardX import SummaryWriter
from tensorboardX.proto.summary_pb2 import Summary

from carpark_mj.policy.runs import write_csv


class MetricsLog:
    """One row per update in `metrics.csv`, the same as TensorBoard scalars.

    On a resume the rows after the checkpoint are removed, so that no update appears
    twice.
    """

    def __init__(self, folder: Path, resume_update: int) -> None:
        """Opens the log of a run that stands at `resume_update` updates."""
        self._path = folder / "metrics.csv"
        rows = [
            row for row in _read_rows(folder) if float(row["update"]) <= resume_update
        ]
        self._columns = list(rows[0]) if rows else []
        write_csv(self._path, rows)
        self._file = self._path.open("a", newline="")
        last_step = int(rows[-1]["env_steps"]) if rows else 0
        self._board = SummaryWriter(
            str(folder / "tensorboard"), purge_step=last_step + 1, flush_secs=20
        )

    def write(self, row: dict[str, float]) -> None:
        """Adds the row of an update; the first row fixes the columns."""
        writer = csv.DictWriter(self._file, self._columns or list(row))
        if not self._columns:
            self._columns = list(row)
            writer.writeheader()
        writer.writerow(row)
        self._file.flush()
        scalars = [
            Summary.Value(tag=name, simple_value=value)
            for name, value in row.items()
            if name not in ("update", "env_steps") and math.isfinite(value)
        ]
        # One event: with one for each scalar a row takes 3 ms, for every run.
        events: Any = self._board.file_writer
        events.add_summary(Summary(value=scalars), int(row["env_steps"]))

    def close(self) -> None:
        """Flushes and closes both."""
        self._file.close()
        self._board.close()


def _read_rows(folder: Path) -> list[dict[str, str]]:
    """Rows of `metrics.csv` as text; a line half-written by a kill ends them."""
    path = folder / "metrics.csv"
    if not path.exists():
        return []
    rows = []
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            try:
                for value in row.values():
                    float(value)
            except (TypeError, ValueError):
                break
            rows.append(row)
    return rows


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """Rows of a run's `metrics.csv` as numbers."""
    return [
        {name: float(value) for name, value in row.items()}
        for row in _read_rows(folder)
    ]
