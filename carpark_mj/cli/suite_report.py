"""The results of the suite as a table on the screen and as files."""

import importlib.metadata
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from carpark_mj.analysis.page import picture, table, write_page
from carpark_mj.evaluation.aggregation import OUTCOMES, Row
from carpark_mj.layouts.held_out import SHA256, VERSION
from carpark_mj.policy.checkpoints import write_atomically
from carpark_mj.policy.runs import write_csv

WORST = 10  # cases shown of a policy and level
# Columns on the screen; files have all.
PRINTED = (
    *("policy", "level", "kind", "cases", "parked [%]", "crashed [%]"),
    *("timed out [%]", "gear changes", "path [m]", "time [s]"),
)
PACKAGES = ("carpark_mj", "mujoco", "jax", "ompl")


def header(rule: str, cases: int, seed: int) -> list[str]:
    """The title of a suite's results, then what they depend on."""
    versions = []
    for package in PACKAGES:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    return [
        f"Hard cases, {rule} rule",
        f"Held-out cases version {VERSION} (SHA-256 {SHA256[:16]}), the first "
        f"{cases} of each level; seed {seed}; "
        f"{jax.devices()[0].device_kind}; {', '.join(versions)}.",
        "Rates with Wilson's 95 % interval; gear changes, paths, errors and times are "
        "means over parked episodes; planning is counted in seconds of the processor.",
    ]


def shown_cells(row: Mapping[str, Any]) -> dict[str, str]:
    """A row of the table as it is shown."""
    shown = {name: str(row[name]) for name in ("policy", "level", "kind", "cases")}
    low, high = 100 * row["low"], 100 * row["high"]
    shown["parked [%]"] = f"{100 * row['parked']:.1f} ({low:.1f} … {high:.1f})"
    for name in ("crashed", "timed out", "path found"):
        shown[f"{name} [%]"] = _number(100 * row[name], 1)
    for name in row:
        if name not in ("parked", "low", "high", "crashed", "timed out", "path found"):
            shown.setdefault(name, _number(row[name], 2))
    return shown


def _number(value: Any, digits: int) -> str:
    if not isinstance(value, float):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def print_rows(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Prints the table; files have more columns."""
    shown = Table(title=title)
    cells = [
        {name: cell for name, cell in shown_cells(row).items() if name in PRINTED}
        for row in rows
    ]
    for name in cells[0]:
        shown.add_column(
            name, justify="left" if name in ("policy", "level") else "right"
        )
    for row in cells:
        shown.add_row(*row.values())
    Console().print(shown)


def write_results(
    folder: Path,
    head: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    episodes: Sequence[Row],
    pictures: Sequence[Path],
) -> list[Path]:
    """Writes `suite.md`, `suite.csv`, `cases.csv` and `suite.html`; returns them.

    Args:
        folder: where.
        head: see `header`.
        rows: of the table.
        episodes: all of them.
        pictures: PNG files for the page.
    """
    cells = [shown_cells(row) for row in rows]
    lines = [f"# {head[0]}", "", *head[1:], "", f"| {' | '.join(cells[0])} |"]
    lines.append(f"|{'---|' * len(cells[0])}")
    lines += [f"| {' | '.join(row.values())} |" for row in cells]
    text = "\n".join(lines) + "\n"
    names = ("suite.md", "suite.csv", "cases.csv", "suite.html")
    files = [folder / name for name in names]
    write_atomically(files[0], lambda temporary: temporary.write_text(text))
    write_csv(files[1], rows)
    columns = list(dict.fromkeys(name for row in episodes for name in row))
    write_csv(files[2], [{n: row.get(n, "") for n in columns} for row in episodes])
    parts = [("Results", table(cells))]
    parts += [(path.stem.capitalize(), picture(path)) for path in pictures]
    parts += [
        (f"Worst cases of {which}", table(_worst(part)))
        for which, part in _parts(episodes)
    ]
    write_page(files[3], head[0], head[1:], parts)
    return files


def _parts(episodes: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Episodes by policy and level."""
    parts: dict[str, list[Row]] = {}
    for row in episodes:
        parts.setdefault(f"{row['policy']}, {row['level']}", []).append(row)
    return list(parts.items())


def _worst(episodes: Sequence[Row]) -> list[dict[str, Any]]:
    """Crashes first, then timeouts, then the slowest."""
    order = sorted(
        episodes, key=lambda row: (-row["crashed"], row["parked"], -row["length"])
    )
    return [
        {
            "case": row["case"],
            "kind": row["kind"],
            "outcome": next(name for name in OUTCOMES if row[name]).replace("_", " "),
            **{
                name: row[name]
                for name in ("length", "path", "gear_changes", "final_distance")
            },
        }
        for row in order[:WORST]
    ]
