"""Learning curves at the junction, ours over the published ones, a panel per cell.

`cederle_2023.csv` has the learning curves that M. Cederle's repository (mcederle99 on
GitHub, `thesis`) keeps as arrays: return of all agents, single runs. Those of the
Q-learners are means of the last 100 training episodes, random actions included.
"""

import csv
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.training.panels import make_panels, write_figure
from carpark_papers.cederle.experiments.cells import Cell
from carpark_papers.cederle.experiments.runs import Outcome
from carpark_papers.cederle.junction.scenarios import scenario

PATH = Path(__file__).parent / "cederle_2023.csv"
THOUSAND = 1e3
LOWEST = -30.0  # shown; the study's QMIX falls to -165 for a moment

Curve = tuple[Sequence[float], Sequence[float]]  # steps, returns


def published_curve(cell: Cell) -> Curve | None:
    """The recorded run of a cell; None = there is none."""
    return _read().get((cell.scenario, cell.algorithm)) if cell.published else None


@functools.cache
def _read() -> dict[tuple[str, str], Curve]:
    found: dict[tuple[str, str], tuple[list[float], list[float]]] = {}
    with PATH.open(newline="") as file:
        for row in csv.DictReader(file):
            key = row["scenario"], row["algorithm"]
            steps, returns = found.setdefault(key, ([], []))
            steps.append(float(row["step"]))
            returns.append(float(row["return"]))
    return {**found}


def draw_curves(runs: Mapping[Cell, Sequence[Outcome]]) -> Figure:
    """Return over the steps: a line per run, the published one black.

    Args:
        runs: finished runs of the cells of a table.
    """
    figure, panels = make_panels(
        len(runs),
        "steps [thousand]; black: Cederle 2023; dashed: solved",
        "return of all agents",
    )
    for axes, (cell, outcomes) in zip(panels, runs.items(), strict=True):
        for outcome in outcomes:
            _plot(axes, outcome.curve, color="tab:blue", alpha=0.6)
        theirs = published_curve(cell)
        if theirs:
            _plot(axes, theirs, color="black")
        threshold = scenario(cell.scenario).solved
        axes.axhline(threshold, color="gray", linestyle="--", linewidth=0.8)
        axes.set_title(cell.name, fontsize="small")
        axes.set_ylim(bottom=LOWEST)
    return figure


def write_curves(path: Path, runs: Mapping[Cell, Sequence[Outcome]]) -> Path:
    """Writes `draw_curves` to a PNG."""
    return write_figure(path, draw_curves(runs))


def _plot(axes: Axes, curve: Curve, **style: Any) -> None:
    steps, returns = curve
    axes.plot([step / THOUSAND for step in steps], returns, linewidth=1.0, **style)
