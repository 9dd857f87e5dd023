"""Draws the figures of the documentation's results from the tables in `docs/results`.

python eval/figures.py

Writes `success.svg`, `families.svg`, `start.svg` and `levels.svg` beside the tables.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("figures", "figures:main")

import csv
import dataclasses
import textwrap
from collections.abc import Callable
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.files import require_writable, write_atomically
from shell import command

INK = "#7d8590"  # text and lines, readable on a light and on a dark page
FIRST, SECOND, THIRD = "#3b82d0", "#e08214", "#2ca05a"
STYLE = {
    "svg.hashsalt": "carpark_mj",  # equal tables give equal files
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "grid.alpha": 0.3,
    "grid.color": INK,
    "legend.framealpha": 0.0,
    "legend.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}
Row = dict[str, str]


@dataclasses.dataclass(frozen=True)
class FiguresConfig:
    """Settings of `python eval/figures.py`.

    Attributes:
        tables: folder of the tables, in which the figures are written.
    """

    tables: str = "docs/results"


def read(path: Path) -> list[Row]:
    """Rows of a table."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def names(rows: list[Row], *columns: str) -> list[str]:
    """Different values of columns, joined by commas, in the order of the rows."""
    return list(dict.fromkeys(label(row, *columns) for row in rows))


def label(row: Row, *columns: str) -> str:
    """Values of columns, joined by commas."""
    return ", ".join(row[column] for column in columns)


def category_axis(axes: Axes, labels: list[str]) -> None:
    """One line per label, the first at the top."""
    axes.set_yticks(range(len(labels)), [textwrap.fill(x, 30) for x in labels])
    axes.set_ylim(len(labels) - 0.5, -0.5)
    axes.grid(axis="x")


def success(axes: Axes, rows: list[Row]) -> None:
    """Share of episodes that do not park, by policy and evaluation."""
    rows = [row for row in rows if row["group"] == "presets"]
    rows = [row for row in rows if row["rule"] == "strict" and row["parked_low"]]
    others = "--num-epochs 4", "four epochs", "rays.near"  # other settings
    rows = [row for row in rows if not any(x in row["training"] for x in others)]
    labels = names(rows, "policy", "evaluation")
    for shipped, colour, name in (
        ("yes", FIRST, "shipped"),
        ("", SECOND, "other seed"),
    ):
        part = [row for row in rows if row["shipped"] == shipped]
        middle = [100 - float(row["parked"]) for row in part]
        low = [100 - float(row["parked_high"]) for row in part]
        high = [100 - float(row["parked_low"]) for row in part]
        seen: dict[str, int] = {}
        places = []
        for row in part:
            text = label(row, "policy", "evaluation")
            seen[text] = seen.get(text, 0) + 1
            offset = 0.2 * (1.5 - seen[text]) * 2 if not shipped else 0.0
            places.append(labels.index(text) + offset)
        errors = [
            [m - x for m, x in zip(middle, low, strict=True)],
            [x - m for m, x in zip(middle, high, strict=True)],
        ]
        axes.errorbar(middle, places, xerr=errors, fmt="o", color=colour, label=name)
    axes.set_xscale("log")
    ticks = (0.01, 0.1, 1, 10)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlabel("not parked [%], 95 % interval")
    category_axis(axes, labels)
    axes.legend(loc="upper right")


def families(axes: Axes, rows: list[Row]) -> None:
    """Success rate of `anywhere` by family of layouts and number of agents."""
    labels = names(rows, "family")
    for shift, (agents, colour) in enumerate(
        (("1", FIRST), ("4", SECOND), ("8", THIRD))
    ):
        part = [row for row in rows if row["agents"] == agents]
        places = [labels.index(row["family"]) + 0.2 * (shift - 1) for row in part]
        name = f"{agents} agent" + "s" * (agents != "1")
        axes.plot(
            [float(row["parked"]) for row in part],
            places,
            "o",
            color=colour,
            label=name,
        )
    axes.set_xlabel("parked [%], three training seeds")
    category_axis(axes, labels)
    axes.legend(loc="lower left")


def start(axes: Axes, rows: list[Row]) -> None:
    """Seconds until a command ends, with empty caches and again."""
    rows = [row for row in rows if row["kind"] == "command"]
    labels = names(rows, "what")
    bars = (("total, empty caches", FIRST, -0.2), ("total, again", SECOND, 0.2))
    for measured, colour, shift in bars:
        part = [row for row in rows if row["measured"] == measured]
        places = [labels.index(row["what"]) + shift for row in part]
        seconds = [float(row["seconds"]) for row in part]
        axes.barh(places, seconds, 0.38, color=colour, label=measured)
    axes.set_xlabel("time to the end of the command [s]")
    short = [text.split(" --")[0] for text in labels]
    category_axis(axes, short)
    axes.legend(loc="lower right")


def levels(axes: Axes, rows: list[Row]) -> None:
    """Success rate by level of the suite and policy."""
    rows = [row for row in rows if row["section"] == "all levels, first cases"]
    labels = names(rows, "level")
    looks = zip("osD^v", (INK, FIRST, SECOND, THIRD, "#c2504f"), strict=True)
    pairs = zip(looks, names(rows, "policy"), strict=True)
    for shift, ((marker, colour), policy) in enumerate(pairs):
        part = [row for row in rows if row["policy"] == policy]
        rates = [float(row["parked"]) for row in part]
        places = [labels.index(row["level"]) + 0.15 * (shift - 2) for row in part]
        axes.plot(rates, places, marker, color=colour, label=policy)
    axes.set_xlabel("parked [%]")
    category_axis(axes, labels)
    axes.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3)


FIGURES: dict[str, tuple[str, Callable[[Axes, list[Row]], None], float]] = {
    "success": ("success.csv", success, 5.8),
    "families": ("families.csv", families, 3.4),
    "start": ("start.csv", start, 5.0),
    "levels": ("suite.csv", levels, 5.0),
}


def run(config: FiguresConfig) -> None:
    """Draws all figures."""
    folder = Path(config.tables)
    for name, (table, draw, height) in FIGURES.items():
        path = folder / f"{name}.svg"
        require_writable(path)
        with matplotlib.rc_context(STYLE):
            figure = Figure((6, height), layout="constrained")
            axes = figure.add_subplot()
            axes.patch.set_alpha(0.0)
            draw(axes, read(folder / table))
            write_atomically(
                path,
                lambda file, figure=figure: figure.savefig(
                    file, format="svg", transparent=True, metadata={"Date": None}
                ),
            )
        print(f"wrote {path}")


main = command(FiguresConfig, run, __doc__)
