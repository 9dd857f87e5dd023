"""Verdicts of several seeds on a yes-or-no question, and pages of small plots."""

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.files import write_atomically

ENOUGH = 5  # seeds for a verdict
CLEAR = 0.8  # share of seeds, or its complement, that is called always, or never
COLUMNS = 4
SIZE = (3.2, 2.4)  # in, of a panel
DPI = 110


def always(rates: Sequence[float]) -> bool | None:
    """Whether it happens always (True) or never (False); None = neither."""
    rate = sum(rates) / len(rates)
    if rate >= CLEAR:
        return True
    return False if 1.0 - rate >= CLEAR else None


def make_panels(count: int, xlabel: str, ylabel: str) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels that share their y axis; the rest of it is empty."""
    rows = math.ceil(count / COLUMNS)
    size = (SIZE[0] * COLUMNS, SIZE[1] * rows)
    figure = Figure(figsize=size, layout="constrained")
    panels = [*figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).flat]
    for axes in panels[:count]:
        axes.grid(alpha=0.3)
    for axes in panels[count:]:
        axes.set_axis_off()
    figure.supxlabel(xlabel)
    figure.supylabel(ylabel)
    return figure, panels[:count]


def write_figure(path: Path, figure: Figure) -> Path:
    """Writes a figure to a PNG."""
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=DPI))
    return path
