"""Cases with the planner's paths, as a picture."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.files import write_atomically
from carpark_mj.geometry import box_corners
from carpark_mj.layouts import Layout
from carpark_mj.planning.paths import PlannedPath, centre
from carpark_mj.vehicle import VehicleParameters

COLUMNS = 4
CELL = (4.4, 2.6)  # inches
AROUND = 5.0  # m shown beyond start, goal and path
GEARS = {1: "tab:blue", -1: "tab:red"}


def plot_paths(
    file: Path,
    cases: list[tuple[str, Layout, PlannedPath | None]],
    car: VehicleParameters,
) -> None:
    """Draws cases: walls grey, the goal green, paths blue forwards and red backwards.

    Args:
        file: PNG.
        cases: titles, layouts and paths.
        car: that drives.
    """
    rows = -(-len(cases) // COLUMNS)
    figure = Figure((COLUMNS * CELL[0], rows * CELL[1]), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, (title, layout, path) in zip(axes.flat, cases, strict=False):
        layout = jax.device_get(layout)
        axis.set_title(title, fontsize=9)
        axis.set_aspect("equal")
        mask = layout.wall_mask
        # Outlined: edges of polygons are too thin to be seen.
        _fill(axis, layout.wall_pose[mask], layout.wall_size[mask], "0.6", width=0.8)
        size = np.array([car.length, car.width])
        _fill(axis, layout.bay_pose[:1], layout.bay_size[:1], "tab:green", 0.4)
        _fill(axis, layout.spawn_pose[:1], size[None], "tab:blue", 0.3)
        for segment in path.segments if path is not None else ():
            driven = centre(car, segment.pose)
            outline = np.asarray(
                box_corners(jnp.asarray(driven[-1]), jnp.asarray(size))
            )
            axis.fill(*outline.T, fill=False, ec=GEARS[segment.gear], lw=0.6)
            axis.plot(*segment.pose[:, :2].T, color=GEARS[segment.gear], lw=1.2)
        low, high = _view(layout, path)
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    write_atomically(file, lambda temporary: figure.savefig(temporary, dpi=80))


def _view(layout: Layout, path: PlannedPath | None) -> np.ndarray:
    """(2, 2) corners of the part of a lot around start, goal and path [m]."""
    poses = [layout.spawn_pose[0], layout.bay_pose[0]]
    parts = [part.pose for part in path.segments] if path is not None else []
    points = np.concatenate([np.stack(poses), *parts])[:, :2]
    ends = np.stack([points.min(axis=0) - AROUND, points.max(axis=0) + AROUND])
    return np.clip(ends, -layout.extent, layout.extent)


def _fill(
    axis: Axes,
    pose: np.ndarray,
    size: np.ndarray,
    color: str,
    alpha: float = 1.0,
    width: float = 0.0,
) -> None:
    for outline in np.asarray(box_corners(jnp.asarray(pose), jnp.asarray(size))):
        axis.fill(*outline.T, color=color, alpha=alpha, lw=width)
