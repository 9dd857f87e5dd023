"""The plan of a scenario, drawn with matplotlib."""

from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.files import write_atomically
from carpark_mj.scene.materials import agent_colour
from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    CORNER,
    CORNER_CENTRES,
    LANES,
    MARKINGS,
    ROAD,
)
from carpark_papers.cederle.junction.routes import Route
from carpark_papers.cederle.junction.scenarios import SCENARIOS, scenario
from carpark_papers.cederle.junction.terminations import GOAL_RADIUS

LONG = 42.0  # m shown of the arms
GRASS, ASPHALT, PATH = "#dfe8d8", "#b9b9b9", "#888888"


def draw_scenario(axes: Any, name: str) -> None:
    """Draws roads, lanes and missions: a dot at a start, a ring of the goal's reach.

    Human-driven cars are black.

    Raises:
        ValueError: there is no such scenario.
    """
    from matplotlib.patches import Circle, Rectangle

    traffic = scenario(name)
    axes.set_facecolor(GRASS)
    for boxes, colour in ((ROAD, ASPHALT), (MARKINGS, "white")):
        for (x, y), (length, width) in boxes:
            corner = x - length / 2, y - width / 2
            axes.add_patch(Rectangle(corner, length, width, fc=colour, ec="none"))
    for centre in CORNER_CENTRES:
        axes.add_patch(Circle(centre, CORNER, fc=GRASS, ec="none"))
    for path in (*LANES.values(), *CONNECTIONS.values()):
        axes.plot(*np.transpose(path), color=PATH, lw=0.5, ls="--")
    for agent, mission in enumerate(traffic.missions):
        colour = agent_colour(agent)
        way = _way(mission.route, mission.start, mission.goal_along)
        axes.plot(*way.T, color=colour, lw=1.5)
        axes.plot(*way[0], "o", color=colour)
        axes.add_patch(Circle(way[-1], GOAL_RADIUS, fc="none", ec=colour))
    for car in traffic.human_cars:
        way = _way(car.route, car.start, np.inf)
        axes.plot(*way.T, color="black", lw=1.2, ls="--")
        axes.plot(*way[0], "s", color="black")
    axes.set_aspect("equal")
    axes.set(xlim=(-LONG, LONG), ylim=(-LONG, 6.0))
    axes.set_title(name, fontsize=9)
    axes.tick_params(labelsize=7)


def _way(route: Route, start: float, end: float) -> np.ndarray:
    """Points (n, 2) of a route between two distances along it [m]."""
    points = route.points
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    along = np.linspace(start, min(end, at[-1]), 100)
    return np.stack([np.interp(along, at, column) for column in points.T], axis=1)


def write_plan(path: Path) -> Path:
    """Writes a picture of the four scenarios."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(7, 4.7), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, name in zip(panels.flat, SCENARIOS, strict=True):
        draw_scenario(axes, name)
    for axes in panels[-1]:
        axes.set_xlabel("x [m]", fontsize=8)
    for axes in panels[:, 0]:
        axes.set_ylabel("y [m]", fontsize=8)
    agents = max(len(scenario(name).missions) for name in SCENARIOS)
    ring: dict[str, Any] = {"marker": "o", "lw": 0, "mfc": "none", "ms": 9}
    figure.legend(
        handles=[
            *(
                Line2D([], [], color=agent_colour(k), marker="o", label=f"agent {k}")
                for k in range(agents)
            ),
            Line2D([], [], color="black", label="reach of a goal", **ring),
            Line2D(
                [], [], color="black", ls="--", marker="s", label="human-driven car"
            ),
        ],
        loc="outside lower center",
        ncols=5,
        fontsize=8,
        frameon=False,
    )
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=160))
    return path
