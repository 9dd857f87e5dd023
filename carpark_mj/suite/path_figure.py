"""The picture of the paths that the planner found in cases."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from carpark_mj.files import write_atomically
from carpark_mj.geometry import box_corners
from carpark_mj.layouts import Layout
from carpark_mj.planning.paths import PlannedPath, centre
from carpark_mj.vehicle import VehicleParameters

COLUMNS = 4
CELL = (1.75, 1.75)  # inches
FOOT = 0.5  # inches, of the legend
ASPECT = 1.2  # width over height of what a cell shows
AROUND = 4.0  # m shown beyond start, goal and path
BAR = 5.0  # m
DPI = 160
GEARS = {1: "tab:blue", -1: "tab:red"}

# Cases of the picture: titles, layouts and paths.
Drawn = list[tuple[str, Layout, PlannedPath | None]]


def plot_paths(file: Path, cases: Drawn, car: VehicleParameters) -> None:
    """Draws cases that a car drives into a PNG, each with a bar of `BAR` metres."""
    rows = -(-len(cases) // COLUMNS)
    size = COLUMNS * CELL[0], rows * CELL[1] + FOOT
    figure = Figure(size, layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False)
    for axis in axes.flat[len(cases) :]:
        axis.axis("off")
    for axis, (title, layout, path) in zip(axes.flat, cases, strict=False):
        axis.set_title(title.replace(": ", "\n"), fontsize=7)
        _draw(axis, layout, path, car)
    handles = [
        Patch(fc="tab:blue", alpha=0.3, label="start"),
        Patch(fc="tab:green", alpha=0.4, label="goal"),
        Patch(fc="0.6", label="obstacle"),
        Line2D([], [], color=GEARS[1], label="forwards"),
        Line2D([], [], color=GEARS[-1], label="backwards"),
        Patch(fc="none", ec="0.3", label="car at a change of gear"),
        Line2D([], [], color="black", lw=2, label=f"{BAR:g} m"),
    ]
    style: dict[str, Any] = {"loc": "outside lower center", "frameon": False}
    figure.legend(handles=handles, ncols=COLUMNS, fontsize=7, **style)
    write_atomically(file, lambda temporary: figure.savefig(temporary, dpi=DPI))


def _draw(
    axis: Axes, lot: Layout, path: PlannedPath | None, car: VehicleParameters
) -> None:
    layout: Any = jax.device_get(lot)
    axis.set_aspect("equal")
    axis.set(xticks=[], yticks=[])
    mask, size = layout.wall_mask, np.array([[car.length, car.width]])
    # Outlined: edges of polygons are too thin to be seen.
    _fill(axis, layout.wall_pose[mask], layout.wall_size[mask], color="0.6", lw=0.8)
    _fill(axis, layout.bay_pose[:1], layout.bay_size[:1], color="tab:green", alpha=0.4)
    _fill(axis, layout.spawn_pose[:1], size, color="tab:blue", alpha=0.3)
    for segment in path.segments if path is not None else ():
        colour, last = GEARS[segment.gear], centre(car, segment.pose[-1:])
        _fill(axis, last, size, fill=False, ec=colour, lw=0.5)
        axis.plot(*segment.pose[:, :2].T, color=colour, lw=1.0)
    (left, low), (right, high) = _view(layout, path)
    axis.set(xlim=(left, right), ylim=(low, high))
    inset = (right - left) / 25
    bar = [left + inset, left + inset + BAR]
    axis.plot(bar, [low + inset] * 2, color="black", lw=2, solid_capstyle="butt")


def _fill(axis: Axes, pose: np.ndarray, size: np.ndarray, **style: Any) -> None:
    """Draws boxes (n, 3), (n, 2), by default without an outline."""
    style.setdefault("lw", 0.0)
    for outline in np.asarray(box_corners(jnp.asarray(pose), jnp.asarray(size))):
        axis.fill(*outline.T, **style)


def _view(layout: Layout, path: PlannedPath | None) -> np.ndarray:
    """(2, 2) corners of the part of a lot around start, goal and path [m]."""
    poses = [layout.spawn_pose[0], layout.bay_pose[0]]
    parts = [part.pose for part in path.segments] if path is not None else []
    points = np.concatenate([np.stack(poses), *parts])[:, :2]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    half = np.ptp(points, axis=0) / 2 + AROUND
    tall = max(half[1], half[0] / ASPECT)
    half = np.array([ASPECT * tall, tall])
    return np.stack([middle - half, middle + half])
