"""The physics report: rows and curves, and how they are written."""

import csv
import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from carpark_mj.files import write_atomically
from carpark_mj.vehicle import VehicleParameters
from vehicle_suite.track import Testbed

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
    """The rows of `EXCERPT` for `compact` as a markdown table, from `report.csv`."""
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
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    title, x_label, y_label, logarithmic = FIGURES[name]
    panels = list(dict.fromkeys(c.panel for c in curves))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(1.0 + 4.2 * columns, 1.0 + 3.0 * rows),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axis, panel in zip(axes.flat, panels, strict=False):
        own = [c for c in curves if c.panel == panel]
        labels = list(dict.fromkeys(c.label for c in own))
        named: set[str] = set()
        for curve in own:
            label = "" if curve.label in named else curve.label
            colour = f"C{labels.index(curve.label)}"
            axis.plot(
                curve.x, curve.y, curve.style, color=colour, label=label, markersize=4
            )
            named.add(curve.label)
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
    plt.close(figure)


SHOWN = "compact"  # the preset whose rows are in the report, if it was driven
INTRODUCTION = """# Vehicle physics: measured against formulas

Written by `{command}`; do not edit.

Every expected value follows from the preset's parameters by the formula in its row
(`formulas.py` in `eval/vehicle_suite`). The test driver sets wheel angles and wheel
torques directly, without pedals and rate limits. Rows about pedals, the hold,
standstill and options (`driver.py`) use the shipped driver.

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
    write_csv(folder / "report.csv", rows)
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
    text = "\n".join(parts)
    write_atomically(folder / "report.md", lambda file: file.write_text(text))
