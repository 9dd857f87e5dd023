"""Plans of layouts, drawn with matplotlib."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.config.checks import counted
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
SHEET = 7.0  # inches, the width of a picture
WIDE = 130.0  # m across it, of many lots
EDGE = 0.5  # m beyond a lot's extent
GAP = 0.015  # of it, between lots
LINE, LETTER = 0.15, 0.072  # inches, of a title
LETTERS = 24  # in a title's line
FONT = 8.0  # points
WALL = 1.2  # points, the least width of a wall: some are 2 cm thick
NUMBER = 1.0  # m, the height of a bay's number
POINTS = 72.0  # of an inch
DPI = 160


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
        mask = plan.wall_mask & (plan.wall_kind == kind)
        boxes("wall", mask, fc=colour, ec=colour, lw=WALL)
    for row in np.flatnonzero(plan.disc_mask):
        colour = DISC_COLOURS[DiscKind(int(plan.disc_kind[row]))]
        disc = plan.disc_centre[row], plan.disc_radius[row]
        axes.add_patch(Circle(*disc, fc=colour, ec="none"))
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
    axes.set(xlim=(-half_x - EDGE, half_x + EDGE), ylim=(-half_y - EDGE, half_y + EDGE))
    axes.set_aspect("equal")
    axes.set_axis_off()


def _arrow(axes: Any, x: float, y: float, yaw: float, size: float, colour: str) -> None:
    style: dict[str, Any] = {"head_width": 0.5, "length_includes_head": True, "lw": 0.6}
    axes.arrow(x, y, size * np.cos(yaw), size * np.sin(yaw), color=colour, **style)


def plot_layouts(layouts: Sequence[tuple[str, Layout]], path: Path) -> Path:
    """Writes a picture of titled layouts, all to one scale, with a legend.

    A single one has the numbers of its bays, and axes in metres.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    layouts = sorted(layouts, key=lambda lot: -float(lot[1].extent[1]))
    sizes = [2.0 * (np.asarray(layout.extent, float) + EDGE) for _, layout in layouts]
    row = GAP * WIDE + sum(size[0] + GAP * WIDE for size in sizes)
    wide = max(min(WIDE, row), (1 + 2 * GAP) * max(size[0] for size in sizes))
    metre = SHEET / wide  # inches
    lines = [
        textwrap.wrap(f"{name}, {counted(int(layout.bay_mask.sum()), 'bay')}", LETTERS)
        for name, layout in layouts
    ]
    cells = [
        (max(x * metre, LETTER * max(map(len, title))), y * metre + LINE * len(title))
        for (x, y), title in zip(sizes, lines, strict=True)
    ]
    places, high = _pack(cells, GAP * SHEET)
    foot = 5 * LINE
    figure = Figure(figsize=(SHEET, high + foot))
    FigureCanvasAgg(figure)
    shown = zip(layouts, sizes, lines, places, strict=True)
    for (_, layout), size, title, (x, y) in shown:
        width, height = size * metre
        top = 1 - y / (high + foot)
        text: dict[str, Any] = {"fontsize": FONT, "va": "top", "linespacing": 1.1}
        figure.text(x / SHEET, top, "\n".join(title), **text)
        low = top - (height + LINE * len(title)) / (high + foot)
        box = (x / SHEET, low, width / SHEET, height / (high + foot))
        axes = figure.add_axes(box)
        draw_layout(axes, layout)
        if len(layouts) == 1:
            number_bays(axes, layout, metre)
    _legend(figure, [layout for _, layout in layouts], metre)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=DPI))
    return path


def number_bays(axes: Any, layout: Layout, metre: float) -> None:
    """Writes the bays' numbers and ticks in metres; `metre` is in inches."""
    text: dict[str, Any] = {"ha": "center", "va": "center", "color": "#1b4f72"}
    size = min(FONT, NUMBER * metre * POINTS)
    for bay in np.flatnonzero(layout.bay_mask):
        x, y, yaw = np.asarray(layout.bay_pose[bay])
        back = float(layout.bay_size[bay, 0]) / 4  # off the arrow
        place = x - back * np.cos(yaw), y - back * np.sin(yaw)
        axes.text(*place, str(bay), fontsize=size, **text)
    axes.set_axis_on()
    axes.tick_params(direction="in", labelsize=FONT / 2, length=2)
    axes.tick_params("x", pad=-FONT)
    axes.tick_params("y", pad=-2 * FONT)
    axes.spines[:].set_visible(False)
    axes.patch.set_visible(False)


def _pack(
    cells: Sequence[tuple[float, float]], gap: float
) -> tuple[list[tuple[float, float]], float]:
    """Left upper corners of cells in rows across the sheet, and the rows' height."""
    places: list[tuple[float, float]] = []
    x, y, tall = gap, gap, 0.0
    for width, height in cells:
        if x > gap and x + width + gap > SHEET:
            x, y, tall = gap, y + tall + gap, 0.0
        places.append((x, y))
        x, tall = x + width + gap, max(tall, height)
    return places, y + tall + gap


def _legend(figure: Any, lots: Sequence[Layout], metre: float) -> None:
    """Draws the legend of these layouts' colours, and a bar of 10 m."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colours = {"bay": BAY_COLOURS, "wall": WALL_COLOURS, "disc": DISC_COLOURS}
    entries: list[Any] = []
    for part, kinds in colours.items():
        rows = [(getattr(x, f"{part}_kind"), getattr(x, f"{part}_mask")) for x in lots]
        found = {
            int(x) for kind, mask in rows for x in np.asarray(kind)[np.asarray(mask)]
        }
        for kind, colour in kinds.items():
            if int(kind) in found:
                name = kind.name.lower() + " bay" * (part == "bay")
                entries.append(Patch(fc=colour, ec="#444444", lw=0.6, label=name))
    arrow: dict[str, Any] = {"marker": ">", "lw": 0.8, "ms": 3}
    if any(np.any(layout.spawn_mask) for layout in lots):
        start: dict[str, Any] = {"fc": "#2e86c1", "ec": "#1b4f72", "alpha": 0.25}
        entries.append(Patch(**start, label="start region"))
    arrows = {"#888888": "parked heading"}
    if any(np.any(layout.lane_mask) for layout in lots):
        entries.append(Patch(fc="#d9d9d9", label="lane"))
        arrows = {"#b9770e": "driving direction", **arrows}
    entries += [Line2D([], [], color=c, label=x, **arrow) for c, x in arrows.items()]
    y = 4.2 * LINE / figure.get_figheight()
    bar = [GAP, GAP + 10 * metre / SHEET]
    figure.add_artist(Line2D(bar, [y, y], color="black", lw=2))
    figure.text(bar[1] + 0.01, y, "10 m", fontsize=FONT, va="center")
    style: dict[str, Any] = {"loc": "lower center", "ncols": 5, "frameon": False}
    figure.legend(handles=entries, fontsize=FONT, **style)
