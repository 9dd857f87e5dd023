"""Draws the paths that the planner finds in cases of the suite.

python examples/planned_paths.py   # four cases of each of HOPE's levels
python examples/planned_paths.py --levels tpcap --cases 20 --out tpcap.png
"""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enter
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import CheckedConfig, Count, counted
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_writable
from carpark_mj.geometry import box_corners
from carpark_mj.planning.paths import centre
from carpark_mj.planning.policy import planner_policy
from carpark_mj.suite.evaluation import suite_env
from carpark_mj.suite.levels import HOPE_LEVELS, find_level, pick_cases

COLUMNS = 4
CELL = (1.75, 1.75)  # inches
FOOT = 0.5  # inches, of the legend
ASPECT = 1.2  # width over height of what a cell shows
AROUND = 4.0  # m shown beyond start, goal and path
BAR = 5.0  # m
GEARS = {1: "tab:blue", -1: "tab:red"}


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings.

    Attributes:
        levels: of the suite, whose cases are lots alone: without starts of their own.
        cases: the first ones of each level.
        out: PNG to write.
    """

    levels: tuple[str, ...] = HOPE_LEVELS
    cases: Count = 4
    out: Path = Path("planned_paths.png")


def planned(level: str, count: int):
    """The car, and a title, the layout and the path (or None) of each case."""
    cases = pick_cases(level, count)
    if cases.start is not None:
        raise ValueError(f"cases of {level} have starts of their own: not drawn")
    env = ParkingEnv(find_level(level).env(suite_env(EnvConfig(), "strict")))
    policy, planner = planner_policy(env)
    keys = jax.random.split(jax.random.key(0), len(cases.number))
    state, _ = jax.jit(jax.vmap(env.reset_to_layout))(cases.layouts, keys)
    jax.block_until_ready(policy.act(state))  # plans where an episode begins
    found = []
    for lot, number in enumerate(cases.number):
        path = planner.searches(lot, 0)[0].path
        layout = jax.device_get(jax.tree.map(lambda x, k=lot: x[k], cases.layouts))
        result = "no path"
        if path is not None:
            result = f"{path.length:.1f} m, {counted(path.shifts, 'gear change')}"
        found.append((f"{level} {number}\n{result}", layout, path))
    return env.vehicle, found


def draw(axis, layout, path, car):
    """Draws walls, start, goal, and the path with the car where it changes gear."""
    axis.set_aspect("equal")
    mask, size = layout.wall_mask, np.array([[car.length, car.width]])
    # Outlined: edges of polygons are too thin to be seen.
    fill(axis, layout.wall_pose[mask], layout.wall_size[mask], color="0.6", lw=0.8)
    fill(axis, layout.bay_pose[:1], layout.bay_size[:1], color="tab:green", alpha=0.4)
    fill(axis, layout.spawn_pose[:1], size, color="tab:blue", alpha=0.3)
    for segment in path.segments if path is not None else ():
        colour, last = GEARS[segment.gear], centre(car, segment.pose[-1:])
        fill(axis, last, size, fill=False, ec=colour, lw=0.5)
        axis.plot(*segment.pose[:, :2].T, color=colour, lw=1.0)
    (left, low), (right, high) = view(layout, path)
    axis.set(xlim=(left, right), ylim=(low, high), xticks=[], yticks=[])
    inset = (right - left) / 25
    bar = [left + inset, left + inset + BAR]
    axis.plot(bar, [low + inset] * 2, color="black", lw=2, solid_capstyle="butt")


def fill(axis, pose, size, **style):
    """Draws boxes (n, 3), (n, 2), by default without an outline."""
    style.setdefault("lw", 0.0)
    for outline in np.asarray(box_corners(jnp.asarray(pose), jnp.asarray(size))):
        axis.fill(*outline.T, **style)


def view(layout, path):
    """(2, 2) corners of the part of a lot around start, goal and path [m]."""
    poses = [layout.spawn_pose[0], layout.bay_pose[0]]
    parts = [part.pose for part in path.segments] if path is not None else []
    points = np.concatenate([np.stack(poses), *parts])[:, :2]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    half = np.ptp(points, axis=0) / 2 + AROUND
    tall = max(half[1], half[0] / ASPECT)
    half = np.array([ASPECT * tall, tall])
    return np.stack([middle - half, middle + half])


def main(settings: Settings) -> None:
    """Plans and draws."""
    require_writable(settings.out)
    cases = [
        (*case, car)
        for car, found in (planned(x, settings.cases) for x in settings.levels)
        for case in found
    ]
    rows = -(-len(cases) // COLUMNS)
    size = COLUMNS * CELL[0], rows * CELL[1] + FOOT
    figure = Figure(size, layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False)
    for axis in axes.flat[len(cases) :]:
        axis.axis("off")
    for axis, (title, *case) in zip(axes.flat, cases, strict=False):
        axis.set_title(title, fontsize=7)
        draw(axis, *case)
    handles = [
        Patch(fc="tab:blue", alpha=0.3, label="start"),
        Patch(fc="tab:green", alpha=0.4, label="goal"),
        Patch(fc="0.6", label="obstacle"),
        Line2D([], [], color=GEARS[1], label="forwards"),
        Line2D([], [], color=GEARS[-1], label="backwards"),
        Patch(fc="none", ec="0.3", label="car at a change of gear"),
        Line2D([], [], color="black", lw=2, label=f"{BAR:g} m"),
    ]
    place = {"loc": "outside lower center", "frameon": False}
    figure.legend(handles=handles, ncols=COLUMNS, fontsize=7, **place)
    figure.savefig(settings.out, dpi=160)
    print(f"wrote {settings.out}")


def run() -> None:
    """Draws with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("planned_paths", "planned_paths:run")
