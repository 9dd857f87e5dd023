"""Results of the suite as tables and short videos."""

import contextlib
import importlib.metadata
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.evaluation.aggregation import Row, summarize, wilson_interval
from carpark_mj.evaluation.tables import markdown
from carpark_mj.files import write_csv, write_text
from carpark_mj.geometry.obstacles import take
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import Recording
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.video import draw_frame, frame_indices, write_video
from carpark_mj.suite.levels import find_level, in_order, pick_cases
from carpark_mj.suite.results import VEHICLE, Drives, Key, key_of, vehicle_of
from carpark_mj.types import NO_BAY, OUTCOMES
from carpark_mj.vehicle import preset
from carpark_mj.vehicle.parameters import scaled

PLANNER = "planner"
# Columns on the screen; files have all.
PRINTED = (
    *("policy", "level", "kind", "cases", "parked [%]", "crashed [%]"),
    *("hit person [%]", "hit mover [%]", "fastest contact [m/s]"),
    *("near miss [%]", "least gap [m]", "timed out [%]", "gear changes", "path [m]"),
    "time [s]",
)
RATES = (
    *("crashed", "hit person", "hit mover", "near miss"),
    *("timed out", "path found"),
)
DIGITS = {"decisions/s": 0}  # after the point, where not two
PACKAGES = ("carpark_mj", "mujoco", "jax", "ompl")
SIZE = (640, 400)  # pixels
FASTER = 4  # times: 100 s last 25 s
FPS = 10.0
HOLD = 10  # frames that the last one stays
FOLDER = "videos"
AMONG = {  # columns of such levels, and what they are means of
    "hit person": "hit_person",
    "hit mover": "hit_mover",
    "near miss": "near_miss",
    "least gap [m]": "least_gap",
}


def require_gl() -> None:
    """Refuses to draw without OpenGL."""
    if missing := choose_gl():
        raise RenderingError(missing)


def make_videos(
    folder: Path, rows: Sequence[Row], drives: Mapping[Key, Drives]
) -> dict[Key, Path]:
    """Films episodes from above, `FASTER` times as fast as driven; the files."""
    videos: dict[Key, Path] = {}
    for row in rows:
        key = key_of(row)  # with policies by the whole paths of their runs
        path = film_of(folder, key)
        path.parent.mkdir(exist_ok=True)
        _write(path, recording_of(row, drives[key]), drives[key], vehicle_of(row))
        videos[key] = path
    return videos


def film_of(folder: Path, key: Key) -> Path:
    """The file of an episode's film."""
    name = "-".join(quote(str(part), safe="") for part in key)
    return folder / FOLDER / f"{name}.mp4"


def recording_of(row: Row, drive: Drives) -> Recording:
    """An episode as the renderer takes it."""
    steps, goal = round(row["length"]), 0
    place = find_level(row["level"]).numbers.index(row["case"])
    cases = pick_cases(row["level"], 1, place)
    pose_w = drive.pose_w[0, :steps].swapaxes(1, 2)
    last = np.arange(steps)[:, None] == steps - 1
    ends = {name: last & bool(row[name]) for name in OUTCOMES}
    parked, movers = np.zeros((0, 3), np.float32), ()
    if drive.scene is not None:
        cars = drive.scene.parked_cars
        goal = drive.scene.goal[0]
        parked = cars.pose_w[0][cars.bay[0] != NO_BAY]
        movers = jax.tree.map(lambda x: x[0, :steps], drive.scene.movers)
    return Recording(
        layout=jax.tree.map(lambda x: np.asarray(x[0]), cases.layouts),
        ctrl_dt=EnvConfig().sim.ctrl_dt,
        pose_w=pose_w,
        steering=drive.steering[0, :steps],
        speed=drive.speed[0, :steps],
        goal=np.full((steps, 1), goal),
        parked_pose=np.broadcast_to(parked, (*pose_w.shape[:2], *parked.shape)),
        active=np.ones((steps, 1), bool),
        step=np.arange(1, steps + 1)[:, None],
        movers=movers,
        **ends,
    )


def _write(path: Path, recording: Recording, drive: Drives, vehicle: str) -> None:
    car, cars = preset(vehicle), ()
    if drive.scene is not None:
        own = drive.scene.parked_cars
        lengths = own.size[0][own.bay[0] != NO_BAY][:, 0]
        cars = [scaled(car, float(length) / car.length) for length in lengths]
    parked = recording.parked_pose.shape[2]
    stage = Stage(recording.layout, car, 1, parked, (), cars, take(recording.movers, 0))
    with contextlib.closing(LotRenderer(stage, "topdown", SIZE)) as renderer:
        indices, rate = frame_indices(recording, FPS, FASTER, HOLD)
        pictures = (draw_frame(recording, renderer, index) for index in indices)
        write_video(path, pictures, rate)


def made_with() -> str:
    """The processor and the versions of the packages that results depend on."""
    made = jax.devices()[0].device_kind
    for package in PACKAGES:
        try:
            made += f", {package} {importlib.metadata.version(package)}"
        except importlib.metadata.PackageNotFoundError:
            made += f", {package} not installed"
    return made


def header(episodes: Sequence[Row]) -> list[str]:
    """The title of a suite's results, then what they depend on."""
    seeds = sorted({row["seed"] for row in episodes})
    parts: dict[str, list[str]] = {}
    for level in in_order(row["level"] for row in episodes):
        about = find_level(level)
        source = f"{about.source or f'Cases of {level}'} (SHA-256 {about.fingerprint})"
        found = {row["case"] for row in episodes if row["level"] == level}
        counts = f"{len(found)} of {short_level(level)} ({_ranges(found)})"
        parts.setdefault(source, []).append(counts)
    cases = "; ".join(f"{x}: {', '.join(found)}" for x, found in parts.items())
    rules, made = ({row[n] for row in episodes} for n in ("rule", "made_with"))
    car = vehicle_of(episodes[0])
    levels = {row["level"] for row in episodes}
    one = len(levels) == 1 and find_level(*levels).rule  # brings its own
    title = find_level(*levels).source if one else "Hard cases"
    return [
        f"{title}, {', '.join(rules)} rule"
        f"{f', vehicle {car}' if car != VEHICLE else ''}",
        f"{cases}; seed{'s' * (len(seeds) > 1)} "
        f"{', '.join(map(str, seeds))}; on {'; '.join(sorted(made))}.",
        "Rates with Wilson's 95 % interval for the number of cases, however many seeds "
        "drove them; gear changes, paths, errors and times are means over parked "
        "episodes; planning and the planner's decisions are counted in seconds of the "
        "processor, decisions are those of one car at a time.",
    ]


def _ranges(numbers: Iterable[int]) -> str:
    """Whole numbers, those that follow each other as a range: 0 to 3, 7."""
    found = np.array(sorted(numbers))
    runs = np.split(found, np.flatnonzero(np.diff(found) > 1) + 1)
    ends = (dict.fromkeys((run[0], run[-1])) for run in runs)
    return ", ".join(" to ".join(map(str, both)) for both in ends)


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


def same_columns(rows: Sequence[Row]) -> list[Row]:
    """Rows with the columns of all of them, NaN where one has none."""
    columns = dict.fromkeys(name for row in sorted(rows, key=len)[::-1] for name in row)
    return [{name: row.get(name, math.nan) for name in columns} for row in rows]


def by_level(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """A row for each policy, a column for each level: what it parks of all cases."""
    levels = in_order(row["level"] for row in rows)
    found = {row["policy"]: dict.fromkeys(levels, "–") for row in rows}
    for row in rows:  # all kinds of a level are its last row
        found[row["policy"]][row["level"]] = shown_cells(row)["parked [%]"]
    names = shown_levels(levels)
    return [
        {"policy": policy, **{names[x]: cell for x, cell in cells.items()}}
        for policy, cells in found.items()
    ]


def short_level(level: str) -> str:
    """A level's name, of a path its last part."""
    name, colon, path = level.partition(":")
    return f"{name}{colon}{Path(path).name}"


def shown_levels(levels: Iterable[str]) -> dict[str, str]:
    """Short names of levels, but whole ones of those that share theirs."""
    short = {level: short_level(level) for level in levels}
    shared = [*short.values()]
    return {x: name if shared.count(name) == 1 else x for x, name in short.items()}


def _number(value: Any, digits: int) -> str:
    shown = f"{value:.{digits}f}" if isinstance(value, float) else str(value)
    return "–" if shown == "nan" else shown


def write_tables(
    folder: Path, head: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> list[Path]:
    """Writes the table as `suite.md` and `suite.csv`; returns them.

    `head` is that of `header`.
    """
    shown = [
        part for cells in tables_of(rows).values() for part in ("", markdown(cells))
    ]
    files = [folder / name for name in ("suite.md", "suite.csv")]
    write_text(files[0], "\n".join([f"# {head[0]}", "", *head[1:], *shown]) + "\n")
    seeds = (" ".join(map(str, row["by seed"])) for row in rows)
    columns = zip(rows, seeds, strict=True)
    write_csv(files[1], [{**row, "by seed": rates} for row, rates in columns])
    return files


def tables_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[dict[str, str]]]:
    """The cells of the table, and before it those by level if there are several."""
    names = shown_levels(row["level"] for row in rows)
    cells = [shown_cells(row) | {"level": names[row["level"]]} for row in rows]
    tables = {"Results": cells}
    if len(names) > 1:
        tables = {"Parked [%] by level": by_level(rows)} | tables
    return tables


def worst_first(rows: Sequence[Row]) -> list[Row]:
    """Episodes in order: crashes, then timeouts, then the slowest."""
    return sorted(rows, key=lambda x: (-x["crashed"], x["parked"], -x["length"]))


def table_rows(policy: str, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """A row of results for every level and kind of a policy, of all episodes.

    Those of the planner also have `planned`, whether it found a path, `planned_path`,
    its length [m], and `planning_seconds`.
    """
    plans = {
        (row["seed"], row["level"], row["case"]): row["planned_path"]
        for row in rows
        if not math.isnan(row.get("planned_path", math.nan))
    }
    own = [row for row in rows if row["policy"] == policy]
    found = []
    for level in in_order(row["level"] for row in own):
        of_level = [row for row in own if row["level"] == level]
        kinds = sorted({row["kind"] for row in of_level})
        for kind in (*kinds, "all") if len(kinds) > 1 else kinds:
            part = [row for row in of_level if kind in ("all", row["kind"])]
            which = {"policy": policy, "level": level, "kind": kind}
            found.append(which | _sum(part, plans))
    return found


def _sum(rows: list[Row], plans: dict[tuple[int, str, int], float]) -> dict[str, Any]:
    summary, seeds = summarize(rows), sorted({row["seed"] for row in rows})
    cases = len({row["case"] for row in rows})
    found = [plans.get((x["seed"], x["level"], x["case"]), 0.0) for x in rows]
    pairs = zip(rows, found, strict=True)
    ratios = [row["path"] / x for row, x in pairs if row["parked"] and x > 0]
    rate = summary["parked"]["rate"]
    # The same case with another seed is not another case.
    low, high = wilson_interval(rate * cases, cases)
    decision = _mean(rows, "ms / decision")
    among = [row for row in rows if "least_gap" in row]
    hits = {name: _mean(among, key) for name, key in AMONG.items()} if among else {}
    if among:
        speeds = [row["contact_speed"] for row in among if row["contact_speed"] > 0]
        hits["fastest contact [m/s]"] = max(speeds, default=math.nan)
    return {
        "cases": cases,
        "seeds": len(seeds),
        "parked": rate,
        "low": low,
        "high": high,
        "by seed": [
            _mean([x for x in rows if x["seed"] == k], "parked") for k in seeds
        ],
        "crashed": summary["crashed"]["rate"],
        **hits,
        "timed out": summary["timed_out"]["rate"],
        "path found": _mean(rows, "planned"),
        "gear changes": summary["gear_changes"],
        "path [m]": summary["path"],
        "path / planned": float(np.mean(ratios)) if ratios else math.nan,
        "off by [m]": summary["final_distance"],
        "off by [deg]": math.degrees(summary["final_heading"]),
        "time [s]": summary["time_to_park"],
        "planning [s]": _mean(rows, "planning_seconds"),
        "ms / decision": decision,
        "decisions/s": 1e3 / decision,
    }


def _mean(rows: Sequence[Row], name: str) -> float:
    values = [row[name] for row in rows if name in row]
    return float(np.mean(values)) if values else math.nan
