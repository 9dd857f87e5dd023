"""The physics report: rows of manoeuvres, and how they are written.

`rows.csv` has the formula, the unit and the tolerance of every row. The first line
whose name (`*` stands for any text) matches is the row's. A tolerance is the larger of
a share of the expected value and an absolute one.
"""

import dataclasses
import functools
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from carpark_mj.evaluation.tables import markdown
from carpark_mj.files import write_csv, write_text
from carpark_mj.reading import read_csv
from carpark_mj.vehicle import VehicleParameters

HERE = Path(__file__).parent
SHOWN = "compact"  # the preset whose rows are in the report, if it was driven


@dataclasses.dataclass(frozen=True)
class Row:
    """A measurement, its expectation, and the largest difference that passes.

    The last field is the physical reason where the tolerance is not the usual one.
    """

    row: str
    preset: str
    formula: str
    unit: str
    measured: float
    expected: float
    tolerance: float
    why: str = ""

    @property
    def passes(self) -> bool:
        """Whether it lies within the tolerance; a NaN does not."""
        return abs(self.measured - self.expected) <= self.tolerance

    @property
    def verdict(self) -> str:
        """One line: pass or MISS, how far off, and the reason of the tolerance."""
        off = self.measured - self.expected
        by = f"{off:+.2g} of ±{self.tolerance:.2g} {self.unit}".rstrip()
        if self.expected and self.tolerance < abs(self.expected):
            scale = 100 / abs(self.expected)
            by = f"{off * scale:+.2g} % of ±{self.tolerance * scale:.2g} %"
        reason = f"; {self.why}" if self.why else ""
        return f"{'pass' if self.passes else 'MISS'}: {by}{reason}"

    def cells(self) -> dict[str, str]:
        """The row's text in every column."""
        values = vars(self) | {"verdict": self.verdict}
        del values["why"]
        return {k: f"{v:.5g}" if isinstance(v, float) else v for k, v in values.items()}


@dataclasses.dataclass
class Study:
    """A car and what its manoeuvres measured; a `quick` one has fewer, shorter runs."""

    preset: str
    params: VehicleParameters
    quick: bool = False
    rows: list[Row] = dataclasses.field(default_factory=list)

    def row(self, row: str, measured: float, expected: float = 0.0) -> None:
        """Adds a row of `rows.csv`."""
        fact = declared(row)
        share, absolute = (float(fact[key] or 0) for key in ("share", "absolute"))
        numbers = float(measured), float(expected), max(share * abs(expected), absolute)
        texts = row, self.preset, fact["formula"], fact["unit"]
        self.rows.append(Row(*texts, *numbers, fact["why"]))


@functools.cache
def lines() -> list[dict[str, str]]:
    """The lines of `rows.csv`."""
    return [row.cells for row in read_csv(HERE / "rows.csv")]


def declared(row: str) -> dict[str, str]:
    """The line of `rows.csv` of a row; raises `ValueError` if there is none."""
    for fact in lines():
        if fnmatchcase(row, fact["row"]):
            return fact
    raise ValueError(f"rows.csv has no {row!r}")


def excerpt(report: Path, preset: str = SHOWN) -> str:
    """Rows of `excerpt.txt` of one preset in a `report.csv`, as markdown."""
    rows = {
        row.cells["row"]: row
        for row in read_csv(report)
        if row.cells["preset"] == preset
    }
    table = []
    for name in (HERE / "excerpt.txt").read_text().splitlines():
        if row := rows.get(name):
            expected = f"{row.number('expected'):.4g} {row.cells['unit']}"
            measured = f"{row.number('measured'):.4g}"
            cells = {"manoeuvre": name, "expected": expected, "measured": measured}
            table.append(cells)
    return markdown(table)


def write_report(folder: Path, studies: Sequence[Study], command: str) -> list[Row]:
    """Writes `report.csv` and `report.md`; returns the missed rows."""
    rows = [row for study in studies for row in study.rows]
    missed = [row for row in rows if not row.passes]
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "report.csv", [row.cells() for row in rows])
    presets = [study.preset for study in studies]
    shown = SHOWN if SHOWN in presets else presets[0]
    parts = [
        (HERE / "introduction.md").read_text().format(command=command),
        f"{len(rows)} rows, {len(missed)} outside their tolerance; "
        "[report.csv](report.csv) has all with formula, tolerance and verdict.\n",
    ]
    if missed:
        table = markdown([row.cells() for row in missed])
        parts.append(f"## Outside their tolerance\n\n{table}\n")
    table = excerpt(folder / "report.csv", shown)
    parts.append(f"## Excerpt for `{shown}`\n\n{table}\n")
    write_text(folder / "report.md", "\n".join(parts))
    return missed
