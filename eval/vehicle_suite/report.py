"""The physics report: rows and curves, and how they are written.

`rows.csv` has the formula, the unit and the tolerance of every row. The first line
whose name (`*` stands for any text) and tyres (none: all) match is the row's. A
tolerance is the larger of a share of the expected value and an absolute one.
"""

import csv
import dataclasses
import functools
import math
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from carpark_mj.files import write_atomically, write_csv, write_text
from carpark_mj.vehicle import VehicleParameters
from vehicle_suite.testbeds import Testbed

COLUMNS = ("row", "preset", "tyres", "formula", "unit", "measured", "expected",
           "tolerance", "verdict")  # fmt: skip


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
        values = {name: getattr(self, name) for name in COLUMNS}
        return {
            name: f"{value:.5g}" if isinstance(value, float) else value
            for name, value in values.items()
        }


@dataclasses.dataclass(frozen=True)
class Curve:
    """A line of a figure, in the panel of its car.

    Attributes:
        figure: a key of `FIGURES`.
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
    """A car on a testbed, and what its manoeuvres measured.

    Attributes:
        bed: drives its runs.
        preset: name of the car.
        params: the car.
        quick: drive fewer cases, with shorter runs.
        rows: of all manoeuvres.
        curves: likewise.
    """

    bed: Testbed
    preset: str
    params: VehicleParameters
    quick: bool = False
    rows: list[Row] = dataclasses.field(default_factory=lambda: [])
    curves: list[Curve] = dataclasses.field(default_factory=lambda: [])

    @property
    def tyres(self) -> str:
        """Name of the tyre model."""
        return self.bed.tyres

    def row(
        self, row: str, measured: float, expected: float = 0.0, scale: float = math.nan
    ) -> None:
        """Adds a row of `rows.csv`.

        Args:
            row: its name.
            measured: from the simulation.
            expected: from the parameters.
            scale: whose share the tolerance is; by default the expected value.
        """
        fact = declared(row, self.tyres)
        scale = abs(expected if math.isnan(scale) else scale)
        tolerance = max(float(fact["share"] or 0) * scale, float(fact["absolute"] or 0))
        texts = row, self.preset, self.tyres, fact["formula"], fact["unit"]
        numbers = float(measured), float(expected), tolerance
        self.rows.append(Row(*texts, *numbers, fact["why"]))

    def curve(
        self, figure: str, label: str, x: ArrayLike, y: ArrayLike, style: str = "-"
    ) -> None:
        """Adds a curve; see `Curve`."""
        panel = f"{self.preset}, {self.tyres} tyres"
        points = np.asarray(x, float), np.asarray(y, float)
        self.curves.append(Curve(figure, panel, label, *points, style))


@functools.cache
def facts() -> list[dict[str, str]]:
    """The lines of `rows.csv`."""
    with (Path(__file__).parent / "rows.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def declared(row: str, tyres: str) -> dict[str, str]:
    """The line of `rows.csv` of a row; raises `ValueError` if there is none."""
    for fact in facts():
        if fact["tyres"] in ("", tyres) and fnmatchcase(row, fact["row"]):
            return fact
    raise ValueError(f"rows.csv has no {row!r} on {tyres} tyres")


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
    """The rows of `EXCERPT` for `compact` as a markdown table, from `report.csv`."""
    with report.open(newline="") as file:
        found = {
            (row["row"], row["tyres"]): row
            for row in csv.DictReader(file)
            if row["preset"] == "compact"
        }
    lines = ["| manoeuvre | expected | brush | contact |", "|---|---|---|---|"]
    for name in EXCERPT:
        cells = [found.get((name, tyres)) for tyres in ("brush", "contact")]
        rows = [row for row in cells if row]
        numbers = dict.fromkeys(f"{float(row['expected']):.4g}" for row in rows)
        expected = f"{', '.join(numbers)} {rows[0]['unit']}"
        shown = [f"{float(row['measured']):.4g}" if row else "–" for row in cells]
        lines.append(f"| {name} | {expected} | {shown[0]} | {shown[1]} |")
    return "\n".join(lines)


# Small multiples, one panel a car and tyre model: title, x axis, y axis, logarithmic.
FIGURES = {
    "understeer": (
        "Understeer at 20 m/s (ISO 4138): measured (o), brush (--), linear (:)",
        "lateral acceleration [g]",
        "steering angle above atan(L / R) [deg]",
        False,
    ),
    "step_steer": (
        "Step steer (ISO 7401): measured (-), linear single track (--)",
        "time from half the step [s]",
        "yaw rate / steady yaw rate",
        False,
    ),
    "stops": (
        "Stops from 5 m/s: measured (-), formula (--)",
        "distance [m]",
        "speed [m/s]",
        False,
    ),
    "convergence": (
        "Path error over the time step, 6 s of driving",
        "time step [ms]",
        "largest error [mm]",
        True,
    ),
}


def draw(path: Path, name: str, curves: Sequence[Curve]) -> None:
    """Writes a figure of its curves as PNG."""
    title, x_label, y_label, logarithmic = FIGURES[name]
    panels = list(dict.fromkeys(c.panel for c in curves))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure((1.0 + 4.2 * columns, 1.0 + 3.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        colours: dict[str, str] = {}
        for curve in (c for c in curves if c.panel == panel):
            new = curve.label not in colours
            colour = colours.setdefault(curve.label, f"C{len(colours)}")
            label = curve.label if new else ""
            axis.plot(
                curve.x, curve.y, curve.style, color=colour, label=label, markersize=4
            )
        axis.set_title(panel, fontsize=10)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
        if logarithmic:
            axis.set_xscale("log")
            axis.set_yscale("log")
    for axis in axes.flat[len(panels) :]:
        axis.remove()
    figure.suptitle(title)
    figure.supxlabel(x_label)
    figure.supylabel(y_label)
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=110))


SHOWN = "compact"  # the preset whose rows are in the report, if it was driven
INTRODUCTION = """# Vehicle physics: measured against formulas

Written by `{command}`; do not edit.

Every expected value follows from the preset's parameters by the formula in its row
(`formulas.py` in `eval/vehicle_suite`, tolerances in `rows.csv`). The test driver sets
wheel angles and wheel torques directly, without pedals and rate limits. Rows about
pedals, the hold, standstill and options (`driver.py`) use the shipped driver.

- *brush*: MJX in float32 at 10 ms with the tyres that training uses.
- *contact*: C MuJoCo in float64 at 2 ms with the contact wheels of exported scenes.
  They roll without slip and have no scrub torque. On locked wheels they hop (the steps
  in the plot of stops); the stopping distance is right, momentary loads are not.
  Rows of *suspension* put these wheels on their optional springs.
"""
ABSENT = """## Rows that a tyre model does not have, and why

| rows | not on | why |
|---|---|---|
| locked axle | contact | One wheel of a rigid coupled pair always slides whole, with \
mu F_z whatever its slip: no slip stiffness to expect a force from. |
| understeer gradient, linear and brush | contact | Coulomb contacts have no cornering \
stiffness; that their gradient is none is measured instead (*rolling*). |
| step steer, time to 90 % | contact | Without slip angles the yaw rate follows the \
wheels' angle at once. |
| time step of 5 and 10 ms | contact | At more than 4 ms a locked contact wheel \
throws the car: longer steps are refused. |
| unrolled step against mjx.step | contact | Contact wheels need MuJoCo's solver: \
there is no unrolled step. |
| pedals, taps, rolling back, standstill and options | contact | The driver's law \
is the same on any tyres; it is driven on those of training. |
| suspension | brush | The vertical force of a brush tyre has spring and damper in \
it; load transfer and step steer show them. |
| data of a shared model | brush | A car on brush tyres has no constraint whose \
softness could be another car's. |
"""


def write_report(
    folder: Path, rows: Sequence[Row], curves: Sequence[Curve], command: str
) -> None:
    """Writes `report.csv`, `report.md` and the plots."""
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "report.csv", [row.cells() for row in rows])
    missed = [row for row in rows if not row.passes]
    presets = list(dict.fromkeys(row.preset for row in rows))
    shown = SHOWN if SHOWN in presets else presets[0]
    parts = [
        INTRODUCTION.format(command=command),
        f"{len(rows)} rows, {len(missed)} outside their tolerance. "
        f"Below are those of `{shown}`; [report.csv](report.csv) has all.\n",
    ]
    if missed:
        parts.append(f"## Outside their tolerance\n\n{markdown(missed)}\n")
    for name, (title, *_) in FIGURES.items():
        if own := [curve for curve in curves if curve.figure == name]:
            draw(folder / f"{name}.png", name, own)
            parts.append(f"![{title}]({name}.png)\n")
    models = list(dict.fromkeys(row.tyres for row in rows))
    if len(models) > 1:
        parts.append(ABSENT)
    for tyres in models:
        own = [row for row in rows if (row.preset, row.tyres) == (shown, tyres)]
        parts.append(f"## {shown}, {tyres} tyres\n\n{markdown(own)}\n")
    write_text(folder / "report.md", "\n".join(parts))
