"""Results of the suite as files: for other processes, for others to check.

`cases.csv` has a row for each episode, with its rule and the versions of packages;
`worst.npz` has the driven paths of the worst ones.

`suite.json`, an entry of the leaderboard, has a result for each policy and level. Its
`outcomes` have a string for each seed with a letter for each case, in order: p parked,
c crashed, t timed out, d diverged. Rates follow from them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from carpark_mj.evaluation.aggregation import Row, summarize
from carpark_mj.files import write_atomically, write_csv, write_json
from carpark_mj.geometry.obstacles import Group
from carpark_mj.reading import TEXT, Archive, ArrayForm, CsvRow, read_csv
from carpark_mj.suite.levels import find_level
from carpark_mj.types import ENDINGS, ParkedCars

CAR, VEHICLE = "vehicle", "tpcap"  # column of episodes with another car than this


class Scene(NamedTuple):
    """What else a film of n cases shows; leaves have n in front."""

    goal: np.ndarray  # (n,) int32 bays
    parked_cars: ParkedCars  # as the cases began
    movers: tuple[Group, ...]  # obstacles that move by themselves, (n, t, ...)


class Drives(NamedTuple):
    """Driven paths of n cases, t control steps with k poses in each.

    Values after an episode ends are meaningless. The first of the a agents parks.
    """

    pose_w: np.ndarray  # (n, t, a, k, 3) footprint centres
    steering: np.ndarray  # (n, t, a) bicycle angles at the end of the steps [rad]
    speed: np.ndarray  # (n, t, a) signed speeds at the end of the steps [m/s]
    scene: Scene | None = None  # of films; None where none is made. Files lack it

    def of(self, case: int, length: int) -> "Drives":
        """A case (1, ...) with its first control steps."""
        scene = self.scene
        if scene is not None:
            goal, parked = jax.tree.map(lambda x: x[[case]], scene[:2])
            movers = jax.tree.map(lambda x: x[[case], :length], scene.movers)
            scene = Scene(goal, parked, movers)
        paths = {name: getattr(self, name)[[case], :length] for name in PATHS}
        return Drives(**paths, scene=scene)


PATHS = ("pose_w", "steering", "speed")

CASES_FILE, WORST_FILE = "cases.csv", "worst.npz"
_TEXT = ("policy", "rule", "held_out", "made_with", "level", "kind")
_WHOLE = ("seed", "case")
_NEEDED = (
    *(*ENDINGS, "hit_agent", "length", "path", "gear_changes", "time_to_park"),
    *("final_distance", "final_heading", "ms / decision"),
)
_PLANNED = ("planned", "planned_path", "planning_seconds")  # where it has planned


class Key(NamedTuple):
    """Which episode."""

    policy: str
    level: str
    seed: int
    case: int


def key_of(row: Row) -> Key:
    """Key of a row's episode."""
    return Key(*(row[name] for name in Key._fields))


def vehicle_of(row: Row) -> str:
    """The car that parks in a row's episode."""
    return row.get(CAR, VEHICLE)


def write_run(
    folder: Path, episodes: Sequence[Row], drives: Mapping[Key, Drives]
) -> list[Path]:
    """Writes and returns both files; `drives` are of some episodes, n = 1 each."""
    cases = folder / CASES_FILE
    write_csv(cases, episodes)
    length = max(drive.speed.shape[1] for drive in drives.values())
    arrays: dict[str, Any] = {}
    for name in PATHS:
        parts = [getattr(drive, name) for drive in drives.values()]
        shape = len(parts), length, *parts[0].shape[2:]
        arrays[name] = np.zeros(shape, parts[0].dtype)
        for row, part in zip(arrays[name], parts, strict=True):
            row[: part.shape[1]] = part[0]
    arrays |= {n: np.array([getattr(key, n) for key in drives]) for n in Key._fields}
    worst = folder / WORST_FILE

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_atomically(worst, write)
    return [cases, worst]


def read_runs(folders: Sequence[Path]) -> tuple[list[Row], dict[Key, Drives]]:
    """Reads and combines what `write_run` wrote into folders."""
    episodes: dict[Key, Row] = {}
    drives: dict[Key, Drives] = {}
    for folder in folders:
        cases = read_csv(folder / CASES_FILE, *_TEXT, *_WHOLE, *_NEEDED)
        if not cases:
            raise ValueError(f"{folder / CASES_FILE} holds no episode")
        for row in map(_parse, cases):
            key = key_of(row)
            if key in episodes:
                raise ValueError(
                    f"{folder / CASES_FILE} repeats case {key.case} of {key.level} by "
                    f"{key.policy} with seed {key.seed}, which a folder before it has"
                )
            episodes[key] = row
        worst = folder / WORST_FILE
        for key, drive in _read_worst(worst).items():
            if key not in episodes or drive.speed.shape[1] < episodes[key]["length"]:
                raise ValueError(
                    f"{worst} has drives that are not those of {CASES_FILE}"
                )
            drives[key] = drive
    rows = sorted(episodes.values(), key=lambda row: (row["seed"], row["case"]))
    _require_one("under different rules", (row["rule"] for row in rows))
    _require_one("of different cars", map(vehicle_of, rows))
    for (policy, _), own in by_policy(rows).items():
        columns = (tuple(sorted(row.keys() - {*_PLANNED})) for row in own)
        _require_one(f"of {policy} with different columns", columns)
    for policy in {row["policy"] for row in rows}:
        # Devices may differ: what stands before the first comma.
        made = (row["made_with"] for row in rows if row["policy"] == policy)
        versions = (text.partition(", ")[2] for text in made)
        _require_one(f"of {policy} with different versions", versions)
    return rows, drives


def by_policy(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """Episodes by policy and level."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row["policy"], row["level"]), []).append(row)
    return found


def _require_one(what: str, values: Iterable[Any]) -> None:
    if len(found := sorted({*values})) > 1:
        raise ValueError(f"results {what} do not mix: {found}")


def _parse(row: CsvRow) -> Row:
    parsed: Row = {}
    for name, text in row.cells.items():
        if name in (*_TEXT, CAR):
            parsed[name] = text
        elif name in _WHOLE:
            parsed[name] = row.whole(name)
        elif text or name in _NEEDED:  # other levels may have more
            parsed[name] = row.number(name)
    name, case, held_out = parsed["level"], parsed["case"], parsed["held_out"]
    level = find_level(name)
    if case not in level.numbers:
        raise ValueError(f"{row.place}: there is no case {case} of level {name!r}")
    if held_out != level.fingerprint:
        raise ValueError(
            f"{row.place}: it is about other held-out cases, {held_out!r}, not "
            f"{level.fingerprint}"
        )
    ends = [parsed[name] for name in ENDINGS]
    if not {*ends} <= {0.0, 1.0} or not any(ends):
        raise ValueError(f"{row.place}: {', '.join(ENDINGS)} must be 0 or 1, and one 1")
    for name in ("length", "ms / decision"):
        if not 0 < parsed[name] < math.inf:
            raise ValueError(f"{row.place}: {name} must be positive and finite")
    return parsed


def _read_worst(path: Path) -> dict[Key, Drives]:
    try:
        data = Archive(path).read(_FORMS)
    except ValueError as error:
        raise ValueError(f"{path} has no drives of the suite: {error}") from None
    keys = map(Key, *(data[name].tolist() for name in Key._fields))
    return {
        key: Drives(**{name: data[name][[index]] for name in PATHS}, scene=None)
        for index, key in enumerate(keys)
    }


_NUMBER, _STEPS = np.dtype(np.float32), ("drives", "steps", "agents")
_FORMS = {
    "pose_w": ArrayForm(_NUMBER, (*_STEPS, "poses", 3)),
    **dict.fromkeys(("steering", "speed"), ArrayForm(_NUMBER, _STEPS)),
    **dict.fromkeys(("policy", "level"), ArrayForm(TEXT, ("drives",))),
    **dict.fromkeys(_WHOLE, ArrayForm(np.dtype(np.int64), ("drives",))),
}
FORMAT = "carpark_mj suite 1"
SUITE_FILE = "suite.json"
MEANS = ("gear_changes", "path", "time_to_park")  # over parked episodes
_LETTERS = {name[0]: name for name in ENDINGS}
_NAMES = ("policy", "level", "held_out", "made_with")


def write_submission(folder: Path, episodes: Sequence[Row]) -> Path:
    """Writes episodes of the suite, under one rule, as `suite.json`; returns it."""
    found, path = by_policy(episodes), folder / SUITE_FILE
    results = [_entry(found[key]) for key in sorted(found)]
    rules = {"rule": episodes[0]["rule"]}
    if (vehicle := vehicle_of(episodes[0])) != VEHICLE:
        rules[CAR] = vehicle
    write_json(path, {"format": FORMAT, **rules, "results": results})
    return path


def _entry(rows: list[Row]) -> dict[str, Any]:
    rows = sorted(rows, key=lambda row: (row["seed"], row["case"]))
    seeds, means = sorted({row["seed"] for row in rows}), summarize(rows)
    outcomes = dict.fromkeys(seeds, "")
    for row in rows:
        outcomes[row["seed"]] += next(x for x, name in _LETTERS.items() if row[name])
    return {
        **{name: rows[0][name] for name in _NAMES},
        "seeds": seeds,
        "outcomes": [*outcomes.values()],
        **{name: None if math.isnan(means[name]) else means[name] for name in MEANS},
    }
