"""From measurements of several rounds to a markdown table and a CSV."""

import csv
import dataclasses
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from carpark_mj.benchmarking.checkouts import Checkout
from carpark_mj.benchmarking.records import Job, Measurement
from carpark_mj.files import write_atomically

# How the rounds of one checkout are summarized. Other work on the machine can only
# slow a program down, so the best round says most about it.
BEST: dict[str, Callable[[Sequence[float]], float]] = {
    "rate": max,
    "compile_s": min,
    "first_step_s": min,
    "peak_memory_mb": max,
}
COLUMNS = (
    "what",
    "layout",
    "agents",
    "lots",
    "checkout",
    "rate",
    "unit",
    "compile [s]",
    "first step [s]",
    "peak memory [MB]",
)
CSV_COLUMNS = (
    "checkout",
    "commit",
    "round",
    *(field.name for field in dataclasses.fields(Measurement)),
)


@dataclasses.dataclass(frozen=True)
class Row:
    """A measurement, with what and when it was made.

    Attributes:
        job: what was asked for.
        checkout: measured.
        round: counted from 1.
        measurement: the numbers.
    """

    job: Job
    checkout: Checkout
    round: int
    measurement: Measurement


@dataclasses.dataclass(frozen=True)
class Ratio:
    """This checkout's number by the other's.

    Attributes:
        best: of the best rounds.
        low: least of the rounds, in which both were measured one after the other.
        high: most of them.
    """

    best: float
    low: float
    high: float

    def __str__(self) -> str:
        """As the table prints it."""
        return f"{self.best:.3f} ({self.low:.3f} … {self.high:.3f})"


def values(rows: Sequence[Row], name: str) -> list[float]:
    """A number of each row."""
    return [getattr(row.measurement, name) for row in rows]


def ratio(ours: Sequence[Row], theirs: Sequence[Row], name: str) -> Ratio:
    """Compares a number of two checkouts.

    Args:
        ours: rows of one job in this checkout, by round.
        theirs: in the other, as many.
        name: of the number, a key of `BEST`.
    """
    mine, other = values(ours, name), values(theirs, name)
    pairs = [a / b for a, b in zip(mine, other, strict=True)]
    return Ratio(BEST[name](mine) / BEST[name](other), min(pairs), max(pairs))


def table_rows(rows: Sequence[Row]) -> list[list[str]]:
    """Cells of the table: a line for each job and checkout, and one of their ratios."""
    cells: list[list[str]] = []
    for job in dict.fromkeys(row.job for row in rows):
        by_checkout: dict[Checkout, list[Row]] = {}
        for row in rows:
            if row.job == job:
                by_checkout.setdefault(row.checkout, []).append(row)
        cells += [checkout_cells(measured) for measured in by_checkout.values()]
        if len(by_checkout) == 2:
            ours, theirs = by_checkout.values()
            compared = {name: str(ratio(ours, theirs, name)) for name in BEST}
            cells.append([*cells[-2][:4], "ratio", *numbers(compared, "")])
    return cells


def checkout_cells(rows: Sequence[Row]) -> list[str]:
    """Cells of one job in one checkout."""
    about = rows[0].measurement
    best = {name: f"{BEST[name](values(rows, name)):,.1f}" for name in BEST}
    best["rate"] = f"{BEST['rate'](values(rows, 'rate')):,.0f}"
    name, commit = rows[0].checkout.name, rows[0].checkout.commit
    return [
        about.what,
        about.layout,
        str(about.agents),
        f"{about.lots:,}",
        f"{name} ({commit})" if commit and commit != name else name,
        *numbers(best, about.unit),
    ]


def numbers(cells: dict[str, str], unit: str) -> list[str]:
    """The last cells of a line, the unit behind the rate."""
    rate, *others = (cells[name] for name in BEST)
    return [rate, unit, *others]


def markdown(rows: Sequence[Row]) -> str:
    """The table, under a line that names device and versions."""
    about = rows[0].measurement
    lines = [f"{about.device}, JAX {about.jax}, MuJoCo {about.mujoco}", ""]
    lines += ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(cells) + " |" for cells in table_rows(rows)]
    return "\n".join(lines)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Writes every measurement, one a line.

    Raises:
        OSError: `path` cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for row in rows:
        numbers = dataclasses.astuple(row.measurement)
        writer.writerow([row.checkout.name, row.checkout.commit, row.round, *numbers])
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))
