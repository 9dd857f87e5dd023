"""Results of the suite in a file that others can check, and the leaderboard.

A file has a result for each policy and level. Its `outcomes` have a string for each
seed with a letter for each case, in order: p parked, c crashed, t timed out, d
diverged. Rates follow from them. Results known from a table alone have `rates` instead.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from carpark_mj.config import find_rules
from carpark_mj.evaluation.aggregation import Row, summarize, wilson_interval
from carpark_mj.files import write_json
from carpark_mj.reading import read_object, require_entries
from carpark_mj.studies.hope.suite import has_moving_car
from carpark_mj.studies.hope.suite_cases import (
    case_numbers,
    fingerprint,
    in_order,
    require_level,
)
from carpark_mj.types import ENDINGS

FORMAT = "carpark_mj suite 1"
SUITE_FILE = "suite.json"
RATES = ("parked", "crashed", "timed_out")
MEANS = ("gear_changes", "path", "time_to_park")  # over parked episodes
_LETTERS = {name[0]: name for name in ENDINGS}
_TEXT = {"policy": str, "level": str, "held_out": str, "made_with": str}


class Result(NamedTuple):
    """A policy in the cases of a level.

    Attributes:
        entry: of the file: policy, level, seeds and means.
        rates: shares of episodes, by `RATES`.
        cases: how many of the level were driven; further seeds do not add cases.
        checked: whether the rates are counted from outcomes.
    """

    entry: dict[str, Any]
    rates: dict[str, float]
    cases: int
    checked: bool

    @property
    def complete(self) -> bool:
        """Whether every case of the level was driven."""
        return self.cases == len(case_numbers(self.entry["level"]))


def write_submission(folder: Path, episodes: Sequence[Row]) -> Path:
    """Writes episodes of the suite, under one rule, as `suite.json`; returns it."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in episodes:
        found.setdefault((row["policy"], row["level"]), []).append(row)
    path = folder / SUITE_FILE
    results = [_entry(found[key]) for key in sorted(found)]
    rules = {"rule": episodes[0]["rule"], "moving_car": has_moving_car(episodes)}
    write_json(path, {"format": FORMAT, **rules, "results": results})
    return path


def _entry(rows: list[Row]) -> dict[str, Any]:
    rows = sorted(rows, key=lambda row: (row["seed"], row["case"]))
    seeds, means = sorted({row["seed"] for row in rows}), summarize(rows)
    return {
        **{name: rows[0][name] for name in _TEXT},
        "seeds": seeds,
        "outcomes": [
            "".join(
                next(letter for letter, name in _LETTERS.items() if row[name])
                for row in rows
                if row["seed"] == seed
            )
            for seed in seeds
        ],
        **{name: None if math.isnan(means[name]) else means[name] for name in MEANS},
    }


def read_submission(path: Path) -> list[Result]:
    """Reads and checks a file of results.

    Raises:
        ValueError: it is malformed, has other cases than this version, or its numbers
            contradict each other.
        OSError: it cannot be read.
    """
    what = str(path)
    found = read_object(path, format=str, rule=str, moving_car=bool, results=list)
    if found["format"] != FORMAT:
        raise ValueError(f"{what}: format must be {FORMAT!r}, not {found['format']!r}")
    find_rules(found["rule"])
    results: list[Result] = []
    for number, entry in enumerate(found["results"], 1):
        place = f"{what}, result {number}"
        if not isinstance(entry, dict):
            raise ValueError(f"{place} is not a JSON object")
        which = {name: found[name] for name in ("rule", "moving_car")}
        results.append(_result(place, which | entry))
    if not results:
        raise ValueError(f"{what} has no result")
    return results


def _result(place: str, entry: dict[str, Any]) -> Result:
    def refuse(told: str) -> NoReturn:
        raise ValueError(f"{place}: {told}")

    require_entries(entry, place, **_TEXT, seeds=list)
    level, seeds = entry["level"], entry["seeds"]
    try:
        require_level(level)
    except ValueError as error:
        refuse(str(error))
    if entry["held_out"] != fingerprint(level):
        refuse(f"held_out must be {fingerprint(level)!r}, not {entry['held_out']!r}")
    whole = all(type(seed) is int for seed in seeds)
    if not seeds or not whole or len({*seeds}) < len(seeds):
        refuse(f"seeds must be different whole numbers, not {seeds}")
    for name in MEANS:
        value = entry.get(name)
        if value is not None and not _is_number(value, 0.0, math.inf):
            refuse(f"{name} must be a number of at least 0, or null, not {value!r}")
    if ("outcomes" in entry) == ("rates" in entry):
        refuse("outcomes or rates must be given, not both")
    known = len(case_numbers(level))
    if "rates" in entry:
        rates = entry["rates"]
        if not isinstance(rates, dict) or sorted(rates) != sorted(RATES):
            refuse(f"rates must be an object of {', '.join(RATES)}, not {rates!r}")
        if not all(_is_number(rate, 0.0, 1.0) for rate in rates.values()):
            refuse(f"rates must lie in [0, 1], not {rates}")
        # Each is rounded to three digits.
        if not math.isclose(math.fsum(rates.values()), 1.0, abs_tol=0.0015):
            refuse(f"rates must add up to 1, not {math.fsum(rates.values()):g}")
        return Result(entry, rates, known, checked=False)
    outcomes = entry["outcomes"]
    if not isinstance(outcomes, list) or len(outcomes) != len(seeds):
        refuse("outcomes must have a string for each seed")
    if not all(isinstance(x, str) and {*x} <= {*_LETTERS} for x in outcomes):
        refuse(f"outcomes must be strings of the letters {', '.join(_LETTERS)}")
    lengths = {len(letters) for letters in outcomes}
    if len(lengths) > 1 or not 1 <= max(lengths) <= known:
        refuse(f"outcomes must have 1 to {known} letters, as many for each seed")
    letters = "".join(outcomes)
    rates = {name: letters.count(name[0]) / len(letters) for name in RATES}
    return Result(entry, rates, max(lengths), checked=True)


def _is_number(value: Any, low: float, high: float) -> bool:
    return type(value) in (int, float) and low <= value <= high and value < math.inf


def check_submission(path: Path) -> list[Result]:
    """Reads an entry of the leaderboard: outcomes of every case of a level.

    Raises:
        ValueError: see `read_submission`; or outcomes are missing.
        OSError: it cannot be read.
    """
    results = read_submission(path)
    for result in results:
        policy, level = result.entry["policy"], result.entry["level"]
        if not result.checked:
            raise ValueError(f"{path}: {policy} has no outcomes in level {level}")
        if not result.complete:
            raise ValueError(
                f"{path}: {policy} drove {result.cases} of the "
                f"{len(case_numbers(level))} cases of level {level}"
            )
    return results


def leaderboard(results: Iterable[Result]) -> str:
    """The results as a Markdown table, by level and then by parked rate."""
    lines = [
        "| level | policy | rule | parked [%] | crashed [%] | timed out [%] "
        "| gear changes | path [m] | time [s] | seeds |",
        "|---|---|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    results = list(results)
    order = in_order(result.entry["level"] for result in results)
    for result in sorted(
        results, key=lambda r: (order.index(r.entry["level"]), -r.rates["parked"])
    ):
        entry, rates = result.entry, result.rates
        low, high = wilson_interval(rates["parked"] * result.cases, result.cases)
        rule = f"{entry['rule']}{', moving car' * entry['moving_car']}"
        interval = f"({100 * low:.1f} … {100 * high:.1f})"
        cells = [
            *(entry["level"], f"`{entry['policy']}`{' †' * (not result.checked)}"),
            *(rule, f"{100 * rates['parked']:.1f} {interval}"),
            *(f"{100 * rates[name]:.1f}" for name in RATES[1:]),
            *(_shown(entry.get(name)) for name in MEANS),
            str(len(entry["seeds"])),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"
