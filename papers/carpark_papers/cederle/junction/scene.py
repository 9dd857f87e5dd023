"""The junction as a plan and as a MuJoCo scene.

As a `Layout` it goes wherever a lot goes: into the renderer
(`carpark_papers.cederle.video`), and into drivable scenes for any viewer.
"""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from carpark_mj.files import write_atomically
from carpark_mj.layouts.build import assemble, lanes, walls
from carpark_mj.layouts.types import Layout, WallKind
from carpark_mj.scene import looks
from carpark_mj.scene.build import drivable_scene
from carpark_mj.scene.looks import agent_colour
from carpark_mj.scene.markings import LINE_HEIGHT
from carpark_mj.vehicle import VehicleParameters
from carpark_papers.cederle.junction.config import SCENARIOS, scenario
from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    CORNER,
    CORNER_CENTRES,
    EAST,
    HALF_ROAD,
    LANE_WIDTH,
    LANES,
    MARKINGS,
    MOUTH,
    ROAD,
    SOUTH,
    WEST,
    Route,
)
from carpark_papers.cederle.junction.rules import GOAL_RADIUS

LONG = 42.0  # m shown of the arms
GRASS, ASPHALT, PATH = "#dfe8d8", "#b9b9b9", "#888888"


def draw_scenario(axes: Any, name: str) -> None:
    """Draws roads, lanes and missions: a dot at a start, a ring of the goal's reach.

    Human-driven cars are black.
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


KERB_WIDTH, KERB_HEIGHT = 0.15, 0.14  # m
HALF = 40.0  # m, half width of the ground, which holds all arms
_EDGE = HALF + 1.0  # m, where the grass around a lot begins


def plan() -> Layout:
    """The roads as a layout: walls are kerbs and grass; it has lanes and no bays."""
    out = HALF_ROAD + KERB_WIDTH
    grass = [(WEST, EAST, out, _EDGE)]
    kerbs = [(WEST, EAST, HALF_ROAD, out)]
    for side in (-1, 1):
        end = WEST if side < 0 else EAST
        grass += [
            (side * MOUTH, end, -_EDGE, -out),
            (side * out, side * MOUTH, -_EDGE, -MOUTH),
            (end, side * _EDGE, -_EDGE, _EDGE),  # beyond the end of the arm
        ]
        kerbs += [
            (side * MOUTH, end, -out, -HALF_ROAD),
            (side * HALF_ROAD, side * out, SOUTH, -MOUTH),
        ]
    grass.append((-out, out, -_EDGE, SOUTH))
    rows: list[np.ndarray] = []
    for start, end in LANES.values():
        way = np.subtract(end, start)
        yaw = np.arctan2(way[1], way[0])
        rows.append(np.array([*np.add(start, end) / 2, yaw, np.hypot(*way)]))
    lane = np.array(rows)
    size = np.stack([lane[:, 3], np.full(len(lane), LANE_WIDTH)], axis=1)
    return assemble(
        (HALF, HALF),
        walls(*_boxes(grass), WallKind.ISLAND),
        walls(*_boxes(kerbs), WallKind.KERB),
        lanes(lane[:, :3], size),
    )


def add_paint(spec: mujoco.MjSpec) -> None:
    """Adds paint beyond a layout: lines between directions, and rounded corners."""
    still = {"contype": 0, "conaffinity": 0, "group": 1, "castshadow": False}
    for k, ((x, y), (length, width)) in enumerate(MARKINGS):
        spec.worldbody.add_geom(
            name=f"line{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, 0.0],
            size=[length / 2, width / 2, LINE_HEIGHT],
            rgba=looks.LINE,
            **still,
        )
    for k, (x, y) in enumerate(CORNER_CENTRES):
        inner = (CORNER - KERB_WIDTH, KERB_HEIGHT + 0.001, looks.GREEN)
        for name, (radius, height, colour) in (
            ("kerb", (CORNER, KERB_HEIGHT - 0.001, looks.KERB)),
            ("grass", inner),
        ):
            spec.worldbody.add_geom(
                name=f"corner{k}/{name}",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                pos=[x, y, height / 2],
                size=[radius, height / 2, 0.0],
                rgba=colour,
                **still,
            )


def drivable_junction(params: VehicleParameters, pose_w: np.ndarray) -> mujoco.MjSpec:
    """A self-contained scene on contact wheels, cars at poses (cars, 3) and at rest."""
    spec = drivable_scene(plan(), params, pose_w, np.zeros((0, 3)))
    spec.modelname = "junction"
    add_paint(spec)
    return spec


def _boxes(
    sides: list[tuple[float, float, float, float]],
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 3) and sizes (n, 2) of boxes between two x and two y, in any order."""
    x0, x1, y0, y1 = np.array(sides).T
    pose = np.stack([(x0 + x1) / 2, (y0 + y1) / 2, np.zeros_like(x0)], axis=1)
    return pose, np.stack([np.abs(x1 - x0), np.abs(y1 - y0)], axis=1)
