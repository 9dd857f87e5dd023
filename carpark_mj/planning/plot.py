"""Cases with the planner's paths, as a picture."""

from pathlib import Path as File

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.geometry import box_corners
from carpark_mj.layouts import Layout
from carpark_mj.planning.paths import Car, Path
from carpark_mj.policy.checkpoints import write_atomically

COLUMNS = 4
CELL = (4.4, 2.6)  # inches
WAYS = {1: "tab:blue", -1: "tab:red"}


def plot_paths(
    file: File, cases: list[tuple[str, Layout, Path | None]], car: Car
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
        _fill(axis, layout.wall_pose[mask], layout.wall_size[mask], "0.6")
        size = np.array([car.length, car.width])
        _fill(axis, layout.bay_pose[:1], layout.bay_size[:1], "tab:green", 0.4)
        _fill(axis, layout.spawn_pose[:1], size[None], "tab:blue", 0.3)
        for segment in path.segments if path is not None else ():
            centre = car.centre(segment.pose)
            outline = np.asarray(
                box_corners(jnp.asarray(centre[-1]), jnp.asarray(size))
            )
            axis.fill(*outline.T, fill=False, ec=WAYS[segment.way], lw=0.6)
            axis.plot(*segment.pose[:, :2].T, color=WAYS[segment.way], lw=1.2)
        x, y = layout.extent
        axis.set(xlim=(-0.7 * x, 0.7 * x), ylim=(-y, 0.6 * y))
    write_atomically(file, lambda temporary: figure.savefig(temporary, dpi=80))


def _fill(
    axis: Axes, pose: np.ndarray, size: np.ndarray, color: str, alpha: float = 1.0
) -> None:
    for outline in np.asarray(box_corners(jnp.asarray(pose), jnp.asarray(size))):
        axis.fill(*outline.T, color=color, alpha=alpha, lw=0)
