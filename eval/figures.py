"""Draws the figures of the documentation's results from the tables in `docs/results`.

python eval/figures.py

Writes `success.svg`, `families.svg` and `levels.svg` beside the tables.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("figures", "figures:main")

import dataclasses
import itertools
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.files import require_writable, write_atomically
from carpark_mj.reading import read_csv
from shell import command

INK = "#7d8590"  # text and lines, readable on a light and on a dark page
COLOURS = ("#3b82d0", "#e08214", "#2ca05a", "#c2504f", INK)
MARKERS = "oD^vs"
STYLE: Any = {
    "svg.hashsalt": "carpark_mj",  # equal tables give equal files
    "grid.alpha": 0.3,
    "legend.framealpha": 0.0,
    "legend.labelcolor": INK,
} | dict.fromkeys(
    ("axes.edgecolor", "axes.labelcolor", "grid.color", "xtick.color", "ytick.color"),
    INK,
)
OTHER_SETTINGS = "--num-epochs 4", "four epochs", "rays.near"  # not of the presets
Row = dict[str, str]


@dataclasses.dataclass(frozen=True)
class FiguresConfig:
    """Settings of `python eval/figures.py`.

    Attributes:
        tables: folder of the tables, in which the figures are written.
    """

    tables: str = "docs/results"


def places(axes: Axes, labels: Sequence[str]) -> dict[str, int]:
    """Gives every different label a line, the first at the top; returns the lines."""
    lines = {label: line for line, label in enumerate(dict.fromkeys(labels))}
    axes.set_yticks(
        range(len(lines)),
        [textwrap.fill(label, 32, break_on_hyphens=False) for label in lines],
    )
    axes.set_ylim(len(lines) - 0.5, -0.5)
    axes.grid(axis="x")
    return lines


def dots(axes: Axes, rows: list[Row], label: str, series: str, **legend: Any) -> None:
    """Success rates [%] by label, a colour and marker for each value of `series`."""
    lines = places(axes, [row[label] for row in rows])
    names = list(dict.fromkeys(row[series] for row in rows))
    for k, name in enumerate(names):
        part = [row for row in rows if row[series] == name]
        rates = [float(row["parked"]) for row in part]
        shift = 0.5 * (k / (len(names) - 1) - 0.5)
        heights = [lines[row[label]] + shift for row in part]
        axes.plot(rates, heights, MARKERS[k], color=COLOURS[k], label=name)
    axes.set_xlabel("parked [%]")
    axes.legend(**legend).get_title().set_color(INK)


def success(axes: Axes, rows: list[Row]) -> None:
    """Share of episodes that do not park, by policy and evaluation."""
    rows = [
        row
        for row in rows
        if (row["group"], row["rule"]) == ("presets", "strict") and row["parked_low"]
        if not any(words in row["training"] for words in OTHER_SETTINGS)
    ]
    labels = [f"{row['policy']}, {row['evaluation']}" for row in rows]
    lines = places(axes, labels)
    shifts = {line: itertools.cycle((0.25, -0.25)) for line in lines}  # other seeds
    for colour, shipped in zip(COLOURS, ("yes", ""), strict=False):
        name = "shipped" if shipped else "other seed"
        for label, row in zip(labels, rows, strict=True):
            if row["shipped"] != shipped:
                continue
            middle, low, high = (
                100 - float(row[key]) for key in ("parked", "parked_high", "parked_low")
            )
            height = lines[label] + (0.0 if shipped else next(shifts[label]))
            error = [[middle - low], [high - middle]]
            axes.errorbar(middle, height, xerr=error, fmt="o", color=colour, label=name)
            name = ""  # one entry of the legend
    axes.set_xscale("log")
    ticks = (0.01, 0.1, 1, 10)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlabel("not parked [%], 95 % interval")
    axes.legend(loc="upper right")


def levels(axes: Axes, rows: list[Row]) -> None:
    """Success rate by level of the suite and policy."""
    rows = [row for row in rows if row["section"] == "all levels, first cases"]
    above: Any = {"loc": "lower center", "bbox_to_anchor": (0.45, 1.0), "ncols": 3}
    dots(axes, rows, "level", "policy", **above)


def families(axes: Axes, rows: list[Row]) -> None:
    """Success rate of `anywhere` by family of layouts and number of agents."""
    dots(axes, rows, "family", "agents", loc="lower left", title="agents")


FIGURES = {
    "success": ("success.csv", success, 5.8),
    "families": ("families.csv", families, 3.4),
    "levels": ("suite.csv", levels, 5.0),
}


def run(config: FiguresConfig) -> None:
    """Draws all figures."""
    for name, (table, draw, height) in FIGURES.items():
        path = Path(config.tables) / f"{name}.svg"
        require_writable(path)
        with matplotlib.rc_context(STYLE):
            figure = Figure((6, height), layout="constrained")
            rows = read_csv(path.with_name(table))
            draw(figure.add_subplot(), [row.cells for row in rows])
            look: Any = {"transparent": True, "metadata": {"Date": None}}
            write_atomically(path, lambda to: figure.savefig(to, format="svg", **look))  # noqa: B023
        print(f"wrote {path}")


main = command(FiguresConfig, run, __doc__)
