"""Plans of layouts, drawn with matplotlib."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.files import write_atomically
from carpark_mj.geometry import box_corners
from carpark_mj.layouts.types import BayKind, DiscKind, Layout, WallKind

BAY_COLOURS = {
    BayKind.STANDARD: "#ffffff",
    BayKind.ACCESSIBLE: "#9ec9f5",
    BayKind.FAMILY: "#f7c6dd",
    BayKind.RESERVED: "#e3e3e3",
    BayKind.EXIT: "#cdeac0",
}
WALL_COLOURS = {
    WallKind.WALL: "#555555",
    WallKind.KERB: "#999999",
    WallKind.ISLAND: "#7fae6b",
    WallKind.GATE: "#c0392b",
}
DISC_COLOURS = {DiscKind.PILLAR: "#333333", DiscKind.BOLLARD: "#e08a1e"}
ARROW = 8.0  # m between the arrows of a lane


def draw_layout(axes: Any, layout: Layout) -> None:
    """Draws one layout (no batch dimension): bays, walls, discs, lanes, spawn regions.

    Arrows show the directions of lanes and how parked cars point, long and red where
    only one end may go into the bay first; spawn regions are dashed.
    """
    from matplotlib.patches import Circle, Polygon

    plan: Any = jax.device_get(layout)

    def boxes(kind: str, mask: np.ndarray, **style: Any) -> None:
        pose, size = getattr(plan, f"{kind}_pose"), getattr(plan, f"{kind}_size")
        for corners in np.asarray(box_corners(pose[mask], size[mask])):
            axes.add_patch(Polygon(corners, closed=True, **style))

    boxes("lane", plan.lane_mask, fc="#d9d9d9", ec="none")
    boxes("spawn", plan.spawn_mask, fc="#2e86c1", ec="#1b4f72", alpha=0.25, ls="--")
    for kind, colour in BAY_COLOURS.items():
        mask = plan.bay_mask & (plan.bay_kind == kind)
        boxes("bay", mask, fc=colour, ec="#444444", lw=0.6)
    for kind, colour in WALL_COLOURS.items():
        boxes("wall", plan.wall_mask & (plan.wall_kind == kind), fc=colour)
    for row in np.flatnonzero(plan.disc_mask):
        colour = DISC_COLOURS[DiscKind(int(plan.disc_kind[row]))]
        centre, radius = plan.disc_centre[row], plan.disc_radius[row]
        axes.add_patch(Circle(centre, radius, fc=colour, ec="none"))
    one_way = plan.bay_mask & (False if plan.bay_end is None else plan.bay_end > 0)
    parked_pose = np.asarray(layout.parked_pose)
    for bay in np.flatnonzero(plan.bay_mask):
        colour, length = ("#c0392b", 2.0) if one_way[bay] else ("#888888", 0.8)
        x, y, yaw = parked_pose[bay]
        _arrow(axes, x, y, yaw, length, colour)
    for row in np.flatnonzero(plan.lane_mask):
        x, y, yaw = plan.lane_pose[row]
        count = max(int(plan.lane_size[row, 0] / ARROW), 1)
        for along in (np.arange(count) + 0.5 - count / 2) * ARROW:
            place = x + along * np.cos(yaw), y + along * np.sin(yaw)
            _arrow(axes, *place, yaw, 1.5, "#b9770e")
            if not plan.lane_one_way[row]:
                _arrow(axes, *place, yaw + np.pi, 1.5, "#b9770e")
    half_x, half_y = plan.extent
    axes.set(xlim=(-half_x - 1, half_x + 1), ylim=(-half_y - 1, half_y + 1))
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6)


def _arrow(axes: Any, x: float, y: float, yaw: float, size: float, colour: str) -> None:
    axes.arrow(
        x,
        y,
        size * np.cos(yaw),
        size * np.sin(yaw),
        color=colour,
        head_width=0.5,
        length_includes_head=True,
        lw=0.6,
    )


def plot_layouts(layouts: Sequence[tuple[str, Layout]], path: Path) -> Path:
    """Writes a picture of titled layouts, two a row of the sheet's four columns."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 4
    rows = -(-len(layouts) // columns)
    figure = Figure(figsize=(5 * columns, 4 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in grid:
        axes.set_axis_off()
    for axes, (title, layout) in zip(grid, layouts, strict=False):
        axes.set_axis_on()
        draw_layout(axes, layout)
        axes.set_title(f"{title}, {int(layout.bay_mask.sum())} bays", fontsize=9)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=110))
    return path
