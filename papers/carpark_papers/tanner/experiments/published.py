"""The published runs of Tanner 2022, in this package's names and units.

`tanner_2022.csv` has the 329 PPO runs of arXiv 2206.13338's result files: a row each,
metrics over the last 20 % of the steps by the names of `carpark_mj.evaluation`. Points
per step became m/s (0.5625 m / 16 points in 0.2 s), levels of turning rad/s (15 deg in
0.2 s), world units metres (0.5625 m). Runs without global information are labelled
(L,L,.): their result file names no context, and they behave like (G,L,.).
"""

import csv
import functools
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.analysis.runs import Record

PATH = Path(__file__).parent / "tanner_2022.csv"
SOURCE = "Tanner 2022"


def published_runs(figures: Sequence[str]) -> list[Record]:
    """The runs behind some figures."""
    return [record for behind, record in _read() if behind == "+".join(figures)]


def published_values(figures: Sequence[str], field: str) -> tuple[str, ...]:
    """The values that a setting has in them, smallest first."""
    values = {record.settings[field] for record in published_runs(figures)}
    return tuple(sorted(values, key=_order))


@functools.cache
def _read() -> tuple[tuple[str, Record], ...]:
    found: list[tuple[str, Record]] = []
    with PATH.open(newline="") as file:
        for row in csv.DictReader(file):
            figures, words, repeat = (
                row.pop(name) for name in ("figures", "settings", "repeat")
            )
            settings = dict(word.split("=", 1) for word in words.split())
            metrics = {name: float(value) for name, value in row.items() if value}
            name = f"{words} {repeat}"
            found.append((figures, Record(name, settings, metrics, int(repeat))))
    return tuple(found)


def _order(value: str) -> tuple[bool, float, str]:
    try:
        return False, float(value), ""
    except ValueError:
        return True, 0.0, value
