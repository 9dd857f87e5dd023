"""Results of the suite as a table on the terminal, a page and short videos."""

import importlib.metadata
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import jax
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from carpark_mj.analysis import picture, table, video_figure, write_page
from carpark_mj.config import EnvConfig
from carpark_mj.evaluation.aggregation import Row
from carpark_mj.files import write_atomically, write_csv
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import Recording, frames_per_second, num_frames
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.video import draw_frame, write_video
from carpark_mj.suite.evaluation import Drives, has_moving_car, suite_env, worst_first
from carpark_mj.suite.levels import (
    LEVELS,
    TPCAP_LEVEL,
    VERSION,
    case_numbers,
    fingerprint,
    in_order,
    pick_cases,
)
from carpark_mj.suite.results import Key, key_of
from carpark_mj.types import ENDINGS, OUTCOMES
from carpark_mj.vehicle import preset

WORST = 10  # cases shown of a policy and level
# Columns on the screen; files have all.
PRINTED = (
    *("policy", "level", "kind", "cases", "parked [%]", "crashed [%]"),
    *("hit moving car [%]", "hit person [%]", "hit mover [%]", "fastest contact [m/s]"),
    *(
        "near miss [%]",
        "least gap [m]",
        "timed out [%]",
        "gear changes",
        "path [m]",
        "time [s]",
    ),
)
RATES = (
    *("crashed", "hit moving car", "hit person", "hit mover", "near miss"),
    *("timed out", "path found"),
)
DIGITS = {"decisions/s": 0}  # after the point, where not two
WIDTH = 160  # of the table where there is no terminal
PACKAGES = ("carpark_mj", "mujoco", "jax", "ompl")
SIZE = (640, 400)  # pixels
FASTER = 4  # times: 100 s last 25 s
FPS = 10.0
END = 10  # frames that the last one stays
FOLDER = "videos"


class Video(NamedTuple):
    """A video of an episode.

    Attributes:
        row: the episode.
        path: the file.
    """

    row: Row
    path: Path


def require_gl() -> None:
    """Refuses to draw without OpenGL.

    Raises:
        RenderingError: there is none.
    """
    if missing := choose_gl():
        raise RenderingError(missing)


def make_videos(
    folder: Path, rows: Sequence[Row], drives: Mapping[Key, Drives]
) -> list[Video]:
    """Draws episodes from above, `FASTER` times as fast as driven.

    Args:
        folder: the videos' folder is made in it.
        rows: the episodes.
        drives: their driven paths.

    Raises:
        RenderingError: there is no OpenGL.
    """
    videos = []
    for row in rows:
        policy = quote(row["policy"], safe="")  # of runs the whole path
        name = f"{policy}-{row['level']}-{row['seed']}-{row['case']}.mp4"
        path = folder / FOLDER / name
        path.parent.mkdir(exist_ok=True)
        _write(path, recording_of(row, drives[key_of(row)]))
        videos.append(Video(row, path))
    return videos


def recording_of(row: Row, drive: Drives) -> Recording:
    """An episode as the renderer takes it."""
    steps, agents = round(row["length"]), drive.speed.shape[-1]
    first = np.broadcast_to(np.arange(agents) == 0, (steps, agents))  # the one judged
    place = case_numbers(row["level"]).index(row["case"])
    cases = pick_cases(row["level"], 1, place, agents > 1)
    pose_w = drive.pose_w[0, :steps].swapaxes(1, 2)
    ends = {
        name: first & (np.arange(steps) == steps - 1)[:, None] & bool(row[name])
        for name in OUTCOMES
    }
    return Recording(
        layout=jax.tree.map(lambda x: np.asarray(x[0]), cases.layouts),
        ctrl_dt=suite_env(EnvConfig(), "strict").sim.ctrl_dt,
        pose_w=pose_w,
        steering=drive.steering[0, :steps],
        speed=drive.speed[0, :steps],
        goal=np.broadcast_to(np.arange(agents), (steps, agents)),
        parked_pose=np.zeros((*pose_w.shape[:2], 0, 3), np.float32),
        active=np.ones((steps, agents), bool),
        step=np.broadcast_to(np.arange(1, steps + 1)[:, None], (steps, agents)),
        **ends,
    )


def _write(path: Path, recording: Recording) -> None:
    stage = Stage(recording.layout, preset("tpcap"), recording.speed.shape[1], 0)
    renderer = LotRenderer(stage, "topdown", SIZE)
    stride = max(1, round(FASTER * frames_per_second(recording) / FPS))
    last = num_frames(recording) - 1
    indices = [*range(stride - 1, last, stride), *[last] * END]
    try:
        pictures = (draw_frame(recording, renderer, index) for index in indices)
        write_video(path, pictures, FASTER * frames_per_second(recording) / stride)
    finally:
        renderer.close()


def made_with() -> str:
    """The processor and the versions of the packages that results depend on."""
    versions = []
    for package in PACKAGES:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    return f"{jax.devices()[0].device_kind}, {', '.join(versions)}"


def header(episodes: Sequence[Row]) -> list[str]:
    """The title of a suite's results, then what they depend on."""
    seeds = sorted({row["seed"] for row in episodes})
    parts: dict[str, list[str]] = {}
    for level in in_order(row["level"] for row in episodes):
        held_out = f"Held-out cases version {VERSION}"
        source = "TPCAP's cases" if level == TPCAP_LEVEL else held_out
        source = source if level in LEVELS else f"Cases of {level}"
        if found := {row["case"] for row in episodes if row["level"] == level}:
            told = f"{len(found)} of {level} ({_ranges(found)})"
            title = f"{source} (SHA-256 {fingerprint(level)})"
            parts.setdefault(title, []).append(told)
    cases = "; ".join(f"{title}: {', '.join(told)}" for title, told in parts.items())
    rules, made = ({row[n] for row in episodes} for n in ("rule", "made_with"))
    moving = has_moving_car(episodes)
    return [
        f"Hard cases, {', '.join(rules)} rule{', one moving car' if moving else ''}",
        f"{cases}; seed{'s' * (len(seeds) > 1)} "
        f"{', '.join(map(str, seeds))}; on {'; '.join(sorted(made))}.",
        "Rates with Wilson's 95 % interval for the number of cases, however many seeds "
        "drove them; gear changes, paths, errors and times are means over parked "
        "episodes; planning and the planner's decisions are counted in seconds of the "
        "processor, decisions are those of one car at a time.",
    ]


def _ranges(numbers: Iterable[int]) -> str:
    """Whole numbers, those that follow each other as a range: 0 to 3, 7."""
    shown: list[str] = []
    for _, pairs in itertools.groupby(
        enumerate(sorted(numbers)), lambda pair: pair[1] - pair[0]
    ):
        run = [number for _, number in pairs]
        shown.append(f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]))
    return ", ".join(shown)


def shown_cells(row: Mapping[str, Any]) -> dict[str, str]:
    """A row of the table as it is shown."""
    low, high = 100 * row["low"], 100 * row["high"]
    shown: dict[str, str] = {}
    for name, value in row.items():
        if name == "parked":
            shown["parked [%]"] = f"{100 * value:.1f} ({low:.1f} … {high:.1f})"
        elif name == "by seed":
            rates = " ".join(f"{100 * rate:.1f}" for rate in value)
            shown["by seed [%]"] = rates if len(value) > 1 else "–"
        elif name in RATES:
            shown[f"{name} [%]"] = _number(100 * value, 1)
        elif name not in ("low", "high"):
            shown[name] = _number(value, DIGITS.get(name, 2))
    return shown


def _number(value: Any, digits: int) -> str:
    if not isinstance(value, float):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def print_rows(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Prints the table; files have more columns."""
    shown = Table(title=title)
    cells = [
        {name: cell for name, cell in shown_cells(row).items() if name in PRINTED}
        for row in rows
    ]
    for name in cells[0]:
        shown.add_column(
            name, justify="left" if name in ("policy", "level") else "right"
        )
    for row in cells:
        shown.add_row(*map(escape, row.values()))
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH
    console.print(shown)


def write_results(
    folder: Path,
    head: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    episodes: Sequence[Row],
    pictures: Sequence[Path],
    videos: Sequence[Video],
) -> list[Path]:
    """Writes `suite.md`, `suite.csv` and `suite.html`; returns them.

    Args:
        folder: where.
        head: see `header`.
        rows: of the table.
        episodes: all of them.
        pictures: PNG files for the page.
        videos: for the page, in the same folder or below it.
    """
    cells = [shown_cells(row) for row in rows]
    lines = [f"# {head[0]}", "", *head[1:], "", f"| {' | '.join(cells[0])} |"]
    lines.append(f"|{'---|' * len(cells[0])}")
    lines += [f"| {' | '.join(row.values())} |" for row in cells]
    text = "\n".join(lines) + "\n"
    files = [folder / name for name in ("suite.md", "suite.csv", "suite.html")]
    write_atomically(files[0], lambda temporary: temporary.write_text(text))
    listed = {"by seed": lambda rates: " ".join(map(str, rates))}
    write_csv(
        files[1],
        [{n: listed.get(n, lambda x: x)(x) for n, x in row.items()} for row in rows],
    )
    parts = [("Results", table(cells))]
    parts += [(path.stem.capitalize(), picture(path)) for path in pictures]
    for which, part in parts_of(episodes).items():
        own = [video for video in videos if video.row in part]
        shown = "".join(
            video_figure(video.path, files[2], _told(video.row)) for video in own
        )
        parts.append((f"Worst cases of {which}", table(_worst(part)) + shown))
    write_page(files[2], head[0], head[1:], parts)
    return files


def parts_of(episodes: Sequence[Row]) -> dict[str, list[Row]]:
    """Episodes by policy and level."""
    parts: dict[str, list[Row]] = {}
    for row in episodes:
        parts.setdefault(f"{row['policy']}, {row['level']}", []).append(row)
    return parts


def _outcome(row: Row) -> str:
    return next(name for name in ENDINGS if row[name]).replace("_", " ")


def _told(row: Row) -> str:
    """Caption of a video."""
    return f"case {row['case']}, seed {row['seed']}: {_outcome(row)}"


def _worst(episodes: Sequence[Row]) -> list[dict[str, Any]]:
    columns = ("length", "path", "gear_changes", "final_distance")
    return [
        {
            **{name: row[name] for name in ("case", "seed", "kind")},
            "outcome": _outcome(row),
            **{name: row[name] for name in columns},
        }
        for row in worst_first(episodes)[:WORST]
    ]
