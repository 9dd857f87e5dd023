"""The report's rows and how they are written: CSV and markdown."""

import csv
import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from carpark_mj.files import write_atomically

COLUMNS = (
    "row",
    "preset",
    "tyres",
    "formula",
    "unit",
    "measured",
    "expected",
    "tolerance",
    "verdict",
)


@dataclasses.dataclass(frozen=True)
class Row:
    """One measurement against its expectation.

    Attributes:
        row: what is measured.
        preset: the car.
        tyres: the tyre model.
        formula: of the expected value.
        unit: of measured, expected and tolerance.
        measured: from the simulation.
        expected: from the parameters.
        tolerance: largest |measured - expected| that passes.
        why: physical reason where the tolerance is not the usual one.
    """

    row: str
    preset: str
    tyres: str
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
        if self.expected and self.tolerance < abs(self.expected):
            scale = 100 / abs(self.expected)
            by = f"{off * scale:+.2g} % of ±{self.tolerance * scale:.2g} %"
        else:
            by = f"{off:+.2g} of ±{self.tolerance:.2g} {self.unit}".rstrip()
        reason = f"; {self.why}" if self.why else ""
        return f"{'pass' if self.passes else 'MISS'}: {by}{reason}"

    def cells(self) -> dict[str, str]:
        """The row's text in every column."""
        numbers = {
            name: f"{getattr(self, name):.5g}"
            for name in ("measured", "expected", "tolerance")
        }
        return {name: numbers.get(name) or str(getattr(self, name)) for name in COLUMNS}


@dataclasses.dataclass(frozen=True)
class Curve:
    """A line of a figure, in the panel of its car.

    Attributes:
        figure: name of the figure.
        panel: preset and tyres.
        label: in the legend; measurements and their formula share it, and the colour.
        x: (n,).
        y: (n,).
        style: matplotlib's shorthand; dashed lines are formulas.
    """

    figure: str
    panel: str
    label: str
    x: np.ndarray
    y: np.ndarray
    style: str


@dataclasses.dataclass
class Study:
    """Results of the manoeuvres of one car on one tyre model."""

    preset: str
    tyres: str
    rows: list[Row] = dataclasses.field(default_factory=lambda: [])
    curves: list[Curve] = dataclasses.field(default_factory=lambda: [])

    def row(
        self,
        row: str,
        formula: str,
        unit: str,
        measured: float,
        expected: float,
        tolerance: float | tuple[float, str],
    ) -> None:
        """Adds a row; see `Row`. A tolerance may come with its physical reason."""
        largest, why = tolerance if isinstance(tolerance, tuple) else (tolerance, "")
        numbers = float(measured), float(expected), float(largest)
        self.rows.append(
            Row(row, self.preset, self.tyres, formula, unit, *numbers, why)
        )

    def curve(
        self, figure: str, label: str, x: ArrayLike, y: ArrayLike, style: str = "-"
    ) -> None:
        """Adds a curve; see `Curve`."""
        panel = f"{self.preset}, {self.tyres} tyres"
        points = np.asarray(x, float), np.asarray(y, float)
        self.curves.append(Curve(figure, panel, label, *points, style))


def relative(expected: float, share: float) -> float:
    """An absolute tolerance from a share of the expected value."""
    return abs(expected) * share


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Writes the table as CSV."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(row.cells().values() for row in rows)
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))


def markdown(rows: Sequence[Row]) -> str:
    """The table as markdown, one line a row."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for row in rows:
        cells = (cell.replace("|", "\\|") for cell in row.cells().values())
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


EXCERPT = (
    "turning radius, 34.2 deg, 1 m/s forwards",
    "turning radius, 34.2 deg, 1 m/s reverse",
    "kerb-to-kerb circle, published",
    "stop, locked wheels, 5 m/s, heading 45 deg",
    "stop, 0.3 g, 5 m/s, heading 0 deg",
    "coast-down deceleration",
    "longitudinal load transfer, 0.3 g",
    "lateral load transfer, 0.2 g",
    "understeer gradient, axles at 11:12.5, brush",
    "step steer, yaw-rate gain, 10 m/s",
    "step steer, time to 90 %, 10 m/s",
    "scrub torque at standstill, a front wheel",
    "creep on a 20 % slope, 60 s",
    "slip threshold, facing uphill",
    "mirror symmetry, 6 s",
    "time-step error, 10 ms",
    "C MuJoCo against MJX in float32, 1 s",
)


def excerpt(report: Path) -> str:
    """The rows of `EXCERPT` for `compact` as a markdown table, from the report's CSV.

    Args:
        report: `report.csv`.

    Raises:
        KeyError: the report lacks one of `EXCERPT` on brush tyres.
    """
    with report.open(newline="") as file:
        found = {
            (row["row"], row["tyres"]): row
            for row in csv.DictReader(file)
            if row["preset"] == "compact"
        }
    lines = ["| manoeuvre | expected | brush | contact |", "|---|---|---|---|"]
    for name in EXCERPT:
        brush, contact = found[name, "brush"], found.get((name, "contact"))
        expected = f"{float(brush['expected']):.4g} {brush['unit']}"
        if contact and contact["expected"] != brush["expected"]:
            expected = (
                f"{float(brush['expected']):.4g}, "
                f"{float(contact['expected']):.4g} {brush['unit']}"
            )
        values = [f"{float(r['measured']):.4g}" if r else "–" for r in (brush, contact)]
        lines.append(f"| {name} | {expected} | {values[0]} | {values[1]} |")
    return "\n".join(lines)
