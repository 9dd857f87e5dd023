"""A page of small plots, one for each experiment of a study."""

import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.files import write_atomically

COLUMNS = 4
SIZE = (3.2, 2.4)  # in, of a panel
DPI = 110


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
