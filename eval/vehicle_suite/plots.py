"""Figures of the report: small multiples, one panel per car and tyre model."""

from collections.abc import Sequence
from pathlib import Path

from carpark_mj.files import write_atomically
from vehicle_suite.table import Curve

# Name: title, x axis, y axis, and whether both are logarithmic.
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
COLUMNS = 3


def draw(folder: Path, curves: Sequence[Curve]) -> list[str]:
    """Writes a PNG for every figure with curves; returns the figures' names."""
    drawn = [name for name in FIGURES if any(c.figure == name for c in curves)]
    for name in drawn:
        _draw_one(folder / f"{name}.png", name, [c for c in curves if c.figure == name])
    return drawn


def _draw_one(path: Path, name: str, curves: list[Curve]) -> None:
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    title, x_label, y_label, logarithmic = FIGURES[name]
    panels = list(dict.fromkeys(c.panel for c in curves))
    columns = min(COLUMNS, len(panels))
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
            axis.plot(
                curve.x,
                curve.y,
                curve.style,
                color=f"C{labels.index(curve.label)}",
                label="" if curve.label in named else curve.label,
                markersize=4,
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
