"""Plots of several runs: a metric against a setting, and learning curves."""

import contextlib
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.analysis.points import Point, marked, show
from carpark_mj.analysis.runs import read_curve
from carpark_mj.analysis.statistics import spread
from carpark_mj.evaluation.catalogue import metrics
from carpark_mj.files import write_atomically

GRID = 200  # points of a mean curve
MAX_TICKS = 12  # of the horizontal axis; of more values it has round numbers
MAX_INSIDE = 6  # lines whose legend lies on the plot; that of more is beside it
_MARKERS = ("o", "x", "s", "^")
_RING: dict[str, Any] = {
    "marker": "o",
    "markersize": 10,
    "markerfacecolor": "none",
    "color": "tab:red",
    "linestyle": "",
}


def plot_metric(
    path: Path, points: Sequence[Point], by: Sequence[str], metric: str, title: str = ""
) -> None:
    """Draws a metric against the first setting, a line for each value of the others.

    Dots are runs, lines interquartile means, bands their 95 % intervals; a ring marks
    an outlier. Lines of the first source are solid, those of the others dashed: grey,
    or in the colours of the first if it has several.

    Args:
        path: PNG to write.
        points: of all sources.
        by: names of the settings that the points differ in, at least one.
        metric: name of the metric.
        title: above the plot.
    """
    values = list(dict.fromkeys(point.values[0] for point in points))
    numeric = all(isinstance(value, float) for value in values)
    place = {value: float(value if numeric else i) for i, value in enumerate(values)}
    marks = marked(points, metric)
    sources = list(dict.fromkeys(point.source for point in points))
    series = list(dict.fromkeys((p.source, p.values[1:]) for p in points))
    shades = list(dict.fromkeys(rest for _, rest in series))
    with _axes(path, title) as axes:
        for source, rest in series:
            own = [
                (point, mark)
                for point, mark in zip(points, marks, strict=True)
                if (point.source, point.values[1:]) == (source, rest)
            ]
            style = _style(sources.index(source), shades.index(rest), len(shades))
            names = [show(value) for value in rest]
            label = ", ".join([source, *names] if len(sources) > 1 else names) or None
            _draw_series(axes, own, place, metric, {**style, "label": label})
        if any(any(mark) for mark in marks):
            axes.plot([], [], **_RING, label="outlier")
        axes.set(xlabel=by[0], ylabel=_label(metric))
        if not numeric or len(place) <= MAX_TICKS:
            axes.set_xticks([*place.values()], [show(value) for value in place])
        if axes.get_legend_handles_labels()[1]:
            where = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
            axes.legend(
                title=", ".join(by[1:]) or None,
                fontsize="small",
                **(where if len(series) > MAX_INSIDE else {}),
            )


def plot_curves(
    path: Path, points: Sequence[Point], column: str, title: str = ""
) -> bool:
    """Draws the medians and quartiles of training curves; False if there are none.

    Args:
        path: PNG to write.
        points: whose runs have folders.
        column: of `metrics.csv`.
        title: above the plot.
    """
    curves = [
        (point, [c for c in (_curve(record, column) for record in point.records) if c])
        for point in points
    ]
    curves = [(point, found) for point, found in curves if found]
    if not curves:
        return False
    with _axes(path, title) as axes:
        for number, (point, found) in enumerate(curves):
            colour = _colour(number, len(curves))
            end = min(curve[-1][0] for curve in found)
            start = max(curve[0][0] for curve in found)
            steps = np.linspace(start, max(start, end), GRID)
            each = [np.interp(steps, *np.array(curve).T) for curve in found]
            low, middle, high = np.quantile(each, (0.25, 0.5, 0.75), axis=0)
            label = ", ".join(map(show, point.values)) or point.source
            axes.fill_between(steps / 1e6, low, high, color=colour, alpha=0.2, lw=0)
            axes.plot(steps / 1e6, middle, color=colour, label=label)
        axes.set(
            xlabel="agent steps [million]",
            ylabel=f"{column.rpartition('/')[2].replace('_', ' ')} (training)",
        )
        if len(curves) > 1:
            axes.legend(fontsize="small", ncols=1 + len(curves) // 12)
    return True


def _draw_series(
    axes: Any,
    own: Sequence[tuple[Point, Sequence[bool]]],
    place: dict[Any, float],
    metric: str,
    style: dict[str, Any],
) -> None:
    """Draws the points of one source and one value of the other settings."""
    colour = style["color"]
    line: list[tuple[float, float, float, float]] = []
    for point, mark in own:
        x = place[point.values[0]]
        numbers = point.numbers(metric)
        axes.plot(
            [x] * len(numbers),
            numbers,
            style["marker"],
            color=colour,
            markersize=4,
            alpha=0.6,
            linestyle="",
        )
        far = [value for value, is_far in zip(numbers, mark, strict=True) if is_far]
        axes.plot([x] * len(far), far, **_RING)
        found = spread([numbers])
        line.append((x, found.iqm, found.low, found.high))
    x, iqm, low, high = np.array(line).T
    axes.plot(x, iqm, color=colour, linestyle=style["linestyle"], label=style["label"])
    axes.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)


def _curve(record: Any, column: str) -> list[tuple[float, float]]:
    return read_curve(record.folder, column) if record.folder else []


def _label(metric: str) -> str:
    """A metric's name with its unit."""
    units = {known.name: known.unit for known in metrics()}
    unit = units.get(metric)
    return metric.replace("_", " ") + (f" [{unit}]" if unit else "")


def _style(source: int, shade: int, shades: int) -> dict[str, Any]:
    return {
        "color": "0.25" if source and shades == 1 else _colour(shade, shades),
        "marker": _MARKERS[source % len(_MARKERS)],
        "linestyle": "-" if not source else "--",
    }


def _colour(number: int, count: int) -> Any:
    from matplotlib import colormaps

    return f"C{number}" if count <= 10 else colormaps["viridis"](number / (count - 1))


@contextlib.contextmanager
def _axes(path: Path, title: str) -> Generator[Any]:
    """Gives axes to draw in, then writes the picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    try:
        yield axes
        axes.set_title(title)
        axes.grid(alpha=0.3)
        write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120))
    finally:
        plt.close(figure)
