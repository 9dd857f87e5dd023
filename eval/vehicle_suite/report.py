"""The physics report: rows and curves of manoeuvres, and how they are written.

`rows.csv` has the formula, the unit and the tolerance of every row. The first line
whose name (`*` stands for any text) and tyres (none: all) match is the row's. A
tolerance is the larger of a share of the expected value and an absolute one.
`figures.csv` has the plots: small multiples, one panel a car and tyre model.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from carpark_mj.evaluation import tables
from carpark_mj.files import drawn_axes, write_csv, write_text
from carpark_mj.reading import read_csv
from carpark_mj.vehicle import VehicleParameters
from vehicle_suite.testbeds import Testbed, Tyres

HERE = Path(__file__).parent
SHOWN = "compact"  # the preset whose rows are in the report, if it was driven


@dataclasses.dataclass(frozen=True)
class Row:
    """A measurement, its expectation, and the largest difference that passes.

    The last field is the physical reason where the tolerance is not the usual one.
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


class Curve(NamedTuple):
    """A line (n,) of a figure in the panel of its car; one label is one colour."""

    figure: str
    panel: str
    label: str
    x: np.ndarray
    y: np.ndarray
    style: str


@dataclasses.dataclass
class Study:
    """A car on a testbed, and what its manoeuvres measured.

    A `quick` one has fewer cases and shorter runs.
    """

    bed: Testbed
    preset: str
    params: VehicleParameters
    quick: bool = False
    rows: list[Row] = dataclasses.field(default_factory=list)
    curves: list[Curve] = dataclasses.field(default_factory=list)

    @property
    def tyres(self) -> Tyres:
        """The model of the testbed."""
        return self.bed.tyres

    def row(
        self, row: str, measured: float, expected: float = 0.0, scale: float = math.nan
    ) -> None:
        """Adds a row of `rows.csv`; a tolerance may be a share of another scale."""
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
def lines_of(file: str) -> list[dict[str, str]]:
    """The lines of a table beside this file."""
    return [row.cells for row in read_csv(HERE / file)]


def declared(row: str, tyres: str) -> dict[str, str]:
    """The line of `rows.csv` of a row; raises `ValueError` if there is none."""
    for fact in lines_of("rows.csv"):
        if fact["tyres"] in ("", tyres) and fnmatchcase(row, fact["row"]):
            return fact
    raise ValueError(f"rows.csv has no {row!r} on {tyres} tyres")


def excerpt(report: Path, preset: str = SHOWN) -> str:
    """Rows of `excerpt.txt` of one preset in a `report.csv`, as markdown."""
    rows = [row for row in read_csv(report) if row.cells["preset"] == preset]
    lines = []
    for name in (HERE / "excerpt.txt").read_text().splitlines():
        own = {row.cells["tyres"]: row for row in rows if row.cells["row"] == name}
        if not own:
            continue
        wanted = dict.fromkeys(f"{row.number('expected'):.4g}" for row in own.values())
        unit = next(iter(own.values())).cells["unit"]
        line = {"manoeuvre": name, "expected": f"{', '.join(wanted)} {unit}"}
        found = {tyres: f"{row.number('measured'):.4g}" for tyres, row in own.items()}
        lines.append({**line, "brush": "–", "contact": "–", **found})
    return tables.markdown(lines)


def draw(path: Path, look: dict[str, str], curves: Sequence[Curve]) -> None:
    """Writes a figure of its curves as PNG; `look` is its line of `figures.csv`."""
    panels = list(dict.fromkeys(c.panel for c in curves))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    size = 1.0 + 4.2 * columns, 1.0 + 3.0 * rows
    grid: Any = {"nrows": rows, "ncols": columns, "sharex": True, "sharey": True}
    with drawn_axes(path, size, "", **grid) as axes:
        for axis, panel in zip(axes, panels, strict=False):
            colours: dict[str, str] = {}
            for curve in (c for c in curves if c.panel == panel):
                label = "" if curve.label in colours else curve.label
                colour = colours.setdefault(curve.label, f"C{len(colours)}")
                line = {"color": colour, "label": label, "markersize": 4}
                axis.plot(curve.x, curve.y, curve.style, **line)
            axis.set_title(panel, fontsize=10)
            axis.legend(fontsize=8)
            axis.set(xscale=look["scale"], yscale=look["scale"])
        for axis in axes[len(panels) :]:
            axis.remove()
        figure = axes[0].figure
        figure.suptitle(look["title"])
        figure.supxlabel(look["x"])
        figure.supylabel(look["y"])


def write_report(folder: Path, studies: Sequence[Study], command: str) -> list[Row]:
    """Writes `report.csv`, `report.md` and the plots; returns the missed rows."""
    rows = [row for study in studies for row in study.rows]
    curves = [curve for study in studies for curve in study.curves]
    missed = [row for row in rows if not row.passes]
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "report.csv", [row.cells() for row in rows])
    presets = list(dict.fromkeys(row.preset for row in rows))
    shown = SHOWN if SHOWN in presets else presets[0]
    parts = [
        (HERE / "introduction.md").read_text().format(command=command),
        f"{len(rows)} rows, {len(missed)} outside their tolerance; "
        "[report.csv](report.csv) has all with formula, tolerance and verdict.\n",
    ]
    if missed:
        table = tables.markdown([row.cells() for row in missed])
        parts.append(f"## Outside their tolerance\n\n{table}\n")
    for look in lines_of("figures.csv"):
        name, title = look["figure"], look["title"]
        if own := [curve for curve in curves if curve.figure == name]:
            draw(folder / f"{name}.png", look, own)
            parts.append(f"![{title}]({name}.png)\n\n*{title}.*\n")
    if len({row.tyres for row in rows}) > 1:
        parts.append((HERE / "absent.md").read_text())
    if table := excerpt(folder / "report.csv", shown):
        parts.append(f"## Excerpt for `{shown}`\n\n{table}\n")
    write_text(folder / "report.md", "\n".join(parts))
    return missed
