"""Results of the suite for other processes: every episode, and the worst drives.

`cases.csv` has a row for each episode, with its rule and the versions of packages;
`worst.npz` has the driven paths of the worst ones.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from carpark_mj.evaluation.aggregation import Row
from carpark_mj.evaluation.catalogue import metrics
from carpark_mj.files import write_atomically, write_csv
from carpark_mj.reading import TEXT, Archive, ArrayForm, CsvRow, read_csv
from carpark_mj.studies.hope.suite import MOVING_CAR, Drives
from carpark_mj.studies.hope.suite_cases import (
    LEVELS,
    case_numbers,
    fingerprint,
    require_alike,
)
from carpark_mj.studies.hope.suite_levels import EXTRA_LEVELS
from carpark_mj.types import ENDINGS

CASES_FILE, WORST_FILE = "cases.csv", "worst.npz"
_TEXT = ("policy", "rule", "held_out", "made_with", "level", "kind")
_WHOLE = ("seed", "case")
_NEEDED = (
    *(*ENDINGS, "hit_agent", "length", "path", "gear_changes", "time_to_park"),
    *("final_distance", "final_heading", "ms / decision"),
)
_PLANNED = ("planned", "planned_path", "planning_seconds")  # of the planner alone
_LARGEST = 1e15  # of a number; sums of them are finite

Key = tuple[str, str, int, int]  # of an episode: policy, level, seed, case


def key_of(row: Row) -> Key:
    """Key of a row's episode."""
    return row["policy"], row["level"], row["seed"], row["case"]


def write_run(
    folder: Path, episodes: Sequence[Row], drives: Mapping[Key, Drives]
) -> list[Path]:
    """Writes both files; returns them.

    Args:
        folder: where.
        episodes: all of them; numbers that one lacks are left empty.
        drives: of some of them, n = 1 each.
    """
    columns = list(dict.fromkeys(name for row in episodes for name in row))
    cases = folder / CASES_FILE
    write_csv(cases, [{n: row.get(n, "") for n in columns} for row in episodes])
    policy, level, seed, case = (list(part) for part in zip(*drives, strict=True))
    length = max(drive.speed.shape[1] for drive in drives.values())
    arrays = {
        name: np.concatenate([_pad(x, length) for x in parts])
        for name, parts in zip(
            Drives._fields, zip(*drives.values(), strict=True), strict=True
        )
    }
    arrays |= {"policy": np.array(policy), "level": np.array(level)}
    arrays |= {"seed": np.array(seed), "case": np.array(case)}
    worst = folder / WORST_FILE

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    write_atomically(worst, write)
    return [cases, worst]


def _pad(array: np.ndarray, length: int) -> np.ndarray:
    more = [(0, 0)] * array.ndim
    more[1] = (0, length - array.shape[1])
    return np.pad(array, more)


def read_runs(folders: Sequence[Path]) -> tuple[list[Row], dict[Key, Drives]]:
    """Reads and combines what `write_run` wrote into folders.

    Raises:
        ValueError: a file is malformed, repeats an episode, or has other cases than
            this version; or rules, moving cars or a policy's versions of packages
            differ.
        OSError: a file cannot be read.
    """
    episodes: dict[Key, Row] = {}
    drives: dict[Key, Drives] = {}
    for folder in folders:
        for row in _read_cases(folder / CASES_FILE):
            key = key_of(row)
            if key in episodes:
                policy, level, seed, case = key
                raise ValueError(
                    f"{folder / CASES_FILE} repeats case {case} of {level} by {policy} "
                    f"with seed {seed}, which a folder before it has"
                )
            episodes[key] = row
        worst = folder / WORST_FILE
        for key, drive in _read_worst(worst).items():
            if key not in episodes or drive.speed.shape[1] < episodes[key]["length"]:
                raise ValueError(
                    f"{worst} has drives that are not those of {CASES_FILE}"
                )
            drives[key] = drive
    if len({row.get(MOVING_CAR, 0) for row in episodes.values()}) > 1:
        raise ValueError("results with and without a moving car do not mix")
    require_alike({row["level"] for row in episodes.values()})
    rules = sorted({row["rule"] for row in episodes.values()})
    if len(rules) > 1:
        raise ValueError(f"results under different rules do not mix: {rules}")
    for policy in {row["policy"] for row in episodes.values()}:
        own = [row for row in episodes.values() if row["policy"] == policy]
        if len({frozenset(row.keys() - {*_PLANNED}) for row in own}) > 1:
            raise ValueError(f"results of {policy} with different columns do not mix")
        # Devices may differ: what stands before the first comma.
        versions = sorted({row["made_with"].partition(", ")[2] for row in own})
        if len(versions) > 1:
            raise ValueError(
                f"results of {policy} with different versions do not mix: {versions}"
            )
    order = sorted(episodes.values(), key=lambda row: (row["seed"], row["case"]))
    return order, drives


def _read_cases(path: Path) -> list[Row]:
    rows = [_parse(row) for row in read_csv(path, *_TEXT, *_WHOLE, *_NEEDED)]
    if not rows:
        raise ValueError(f"{path} holds no episode")
    for row in rows:
        if row["held_out"] != fingerprint(row["level"]):
            raise ValueError(
                f"{path} is about other held-out cases, {row['held_out']!r}, not "
                f"{fingerprint(row['level'])}"
            )
    return rows


def _parse(row: CsvRow) -> Row:
    parsed: Row = {}
    for name, text in row.cells.items():
        if name in _TEXT:
            parsed[name] = text
        elif name in (*_WHOLE, MOVING_CAR):
            parsed[name] = row.whole(name)
        elif text or name not in _PLANNED:
            parsed[name] = row.number(name)
            if abs(parsed[name]) > _LARGEST:
                raise ValueError(f"{row.place}: {name} is too large, {text}")
    level, case = parsed["level"], parsed["case"]
    known = level in LEVELS or level in EXTRA_LEVELS
    if not known or case not in case_numbers(level):
        raise ValueError(f"{row.place}: there is no case {case} of level {level!r}")
    ends = [parsed[name] for name in ENDINGS]
    if not {*ends} <= {0.0, 1.0} or not any(ends):
        raise ValueError(f"{row.place}: {', '.join(ENDINGS)} must be 0 or 1, and one 1")
    for name in ("length", "ms / decision"):
        if not parsed[name] > 0:
            raise ValueError(
                f"{row.place}: {name} must be positive, not {parsed[name]}"
            )
    for metric in metrics():
        parts = {*(metric.ratio or ())} if metric.pool == "steps" else set[str]()
        if metric.name in parsed and (missing := parts - {*parsed}):
            raise ValueError(f"{row.place}: {metric.name} needs {sorted(missing)}")
    return parsed


def _read_worst(path: Path) -> dict[Key, Drives]:
    try:
        data = Archive(path).read(_FORMS)
    except ValueError as error:
        raise ValueError(f"{path} has no drives of the suite: {error}") from None
    columns = (data[name].tolist() for name in ("policy", "level", "seed", "case"))
    keys = zip(*columns, strict=True)
    return {
        key: Drives(*(data[name][[index]] for name in Drives._fields))
        for index, key in enumerate(keys)
    }


_NUMBER = np.dtype(np.float32)
_FORMS = {
    "pose_w": ArrayForm(_NUMBER, ("drives", "steps", "agents", "poses", 3)),
    "steering": ArrayForm(_NUMBER, ("drives", "steps", "agents")),
    "speed": ArrayForm(_NUMBER, ("drives", "steps", "agents")),
    "policy": ArrayForm(TEXT, ("drives",)),
    "level": ArrayForm(TEXT, ("drives",)),
    "seed": ArrayForm(np.dtype(np.int64), ("drives",)),
    "case": ArrayForm(np.dtype(np.int64), ("drives",)),
}
