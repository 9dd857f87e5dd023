"""What `python eval/suite.py` does: policies in the held-out cases, in one table."""

import dataclasses
import importlib.metadata
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from carpark_mj.analysis.page import table, write_page
from carpark_mj.cli.driver import find_driver
from carpark_mj.config import ParkedRule
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import Row
from carpark_mj.evaluation.suite import (
    Cases,
    decision_time,
    drive_cases,
    pick_cases,
    suite_env,
    table_rows,
)
from carpark_mj.layouts.held_out import CASES, LEVELS, SHA256, VERSION
from carpark_mj.layouts.standards import Level
from carpark_mj.planning.policy import Planner, planner_policy
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.policy.checkpoints import require_writable, write_atomically
from carpark_mj.policy.runs import write_csv

PLANNER = "planner"
WORST = 10  # cases shown of a policy and level
# Columns on the screen; files have all.
PRINTED = (
    *("policy", "level", "kind", "cases", "parked [%]", "crashed [%]"),
    *("timed out [%]", "gear changes", "path [m]", "time [s]"),
)
PACKAGES = ("carpark_mj", "mujoco", "jax", "ompl")


@dataclasses.dataclass(frozen=True)
class SuiteConfig:
    """Settings of `python eval/suite.py`.

    Attributes:
        policies: pretrained policies, run folders, checkpoint files, `planner`, `zero`
            or `random`.
        levels: which levels.
        cases: of each level, from its first one.
        rule: when a car counts as parked.
        seed: of the planner's searches, and of policies that draw.
        out: folder for `suite.md`, `suite.csv`, `cases.csv` and `suite.html`.
    """

    policies: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")
    ] = ()
    levels: tuple[Level, ...] = LEVELS
    cases: int = CASES
    rule: ParkedRule = "strict"
    seed: int = 0
    out: str = "runs/suite"

    def __post_init__(self) -> None:
        if not self.policies:
            raise ValueError("name at least one policy, for example planner")
        if not 1 <= self.cases <= CASES:
            raise ValueError(f"cases must be 1 to {CASES}, not {self.cases}")
        for name in ("policies", "levels"):
            value = getattr(self, name)
            if not value or len(set(value)) < len(value):
                raise ValueError(f"{name} must differ from each other, not {value}")


def main(config: SuiteConfig) -> list[dict[str, Any]]:
    """Drives, prints the table and writes the files; returns the table's rows.

    Raises:
        CheckpointError: a run cannot be read.
        ValueError: impossible settings.
        OSError: the output folder cannot be written.
    """
    folder = Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    require_writable(folder / "suite.csv")  # refused before the work
    drivers = {name: find_driver(name) for name in config.policies}
    cases = [pick_cases(level, config.cases) for level in config.levels]
    # The planner first: others are compared with its paths.
    names = sorted(config.policies, key=lambda name: name != PLANNER)
    rows: list[dict[str, Any]] = []
    episodes: list[Row] = []
    plans: dict[tuple[str, int], Row] = {}
    for name in names:
        env = ParkingEnv(suite_env(drivers[name].env, config.rule))
        own: list[Row] = []
        for part in cases:
            policy, planner = _policy(name, drivers[name].policy, env, config.seed)
            found = drive_cases(env, policy, part, config.seed)
            if planner is not None:
                plans |= _plans(planner, part)
            key = [(row["level"], row["case"]) for row in found]
            found = [
                row | plans.get(which, {})
                for row, which in zip(found, key, strict=True)
            ]
            seconds = _seconds(env, policy, planner, part)
            own += [row | {"ms / decision": 1e3 * seconds} for row in found]
        rows += [_complete(row, own) for row in table_rows(name, own)]
        episodes += [{"policy": name} | row for row in own]
    head = _header(config)
    _print(rows, head[0])
    written = _write(folder, head, rows, episodes)
    print(f"wrote {', '.join(map(str, written))}")
    return rows


def _policy(
    name: str, make: Any, env: ParkingEnv, seed: int
) -> tuple[AnyPolicy, Planner | None]:
    return planner_policy(env, seed) if name == PLANNER else (make(env), None)


def _plans(planner: Planner, cases: Cases) -> dict[tuple[str, int], Row]:
    """What the planner's first search found in every case."""
    found: dict[tuple[str, int], Row] = {}
    for lot, number in enumerate(cases.number.tolist()):
        first = planner.searches(lot, 0)[0]
        found[cases.level, number] = {
            "planned": float(first.path is not None),
            "planned_path": first.path.length if first.path else math.nan,
            "planning_seconds": first.seconds,
        }
    return found


def _seconds(
    env: ParkingEnv, policy: AnyPolicy, planner: Planner | None, cases: Cases
) -> float:
    if planner is not None:
        return planner.seconds / planner.decisions
    return decision_time(env, policy, cases)


def _complete(row: dict[str, Any], episodes: Sequence[Row]) -> dict[str, Any]:
    """A row of the table with times, and with the planner's own success."""
    part = [
        each
        for each in episodes
        if each["level"] == row["level"] and row["kind"] in ("all", each["kind"])
    ]

    def mean(name: str) -> float:
        values = [each[name] for each in part if name in each]
        return float(np.mean(values)) if values else math.nan

    own = row["policy"] == PLANNER
    return row | {
        "ms / decision": mean("ms / decision"),
        "path found": mean("planned") if own else math.nan,
        "planning [s]": mean("planning_seconds") if own else math.nan,
    }


def _header(config: SuiteConfig) -> list[str]:
    """Title, then what the numbers depend on."""
    versions = []
    for package in PACKAGES:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    return [
        f"Hard cases, {config.rule} rule",
        f"Held-out cases version {VERSION} (SHA-256 {SHA256[:16]}), the first "
        f"{config.cases} of each level; seed {config.seed}; "
        f"{jax.devices()[0].device_kind}; {', '.join(versions)}.",
        "Rates with Wilson's 95 % interval; gear changes, paths, errors and times are "
        "means over parked episodes; planning is counted in seconds of the processor.",
    ]


def _cells(row: Mapping[str, Any]) -> dict[str, str]:
    """A row as it is shown."""
    shown = {name: str(row[name]) for name in ("policy", "level", "kind", "cases")}
    low, high = 100 * row["low"], 100 * row["high"]
    shown["parked [%]"] = f"{100 * row['parked']:.1f} ({low:.1f} … {high:.1f})"
    for name in ("crashed", "timed out", "path found"):
        shown[f"{name} [%]"] = _number(100 * row[name], 1)
    for name in row:
        if name not in ("parked", "low", "high", "crashed", "timed out", "path found"):
            shown.setdefault(name, _number(row[name], 2))
    return shown


def _number(value: Any, digits: int) -> str:
    if not isinstance(value, float):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def _print(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    shown = Table(title=title)
    cells = [
        {name: cell for name, cell in _cells(row).items() if name in PRINTED}
        for row in rows
    ]
    for name in cells[0]:
        shown.add_column(
            name, justify="left" if name in ("policy", "level") else "right"
        )
    for row in cells:
        shown.add_row(*row.values())
    Console().print(shown)


def _write(
    folder: Path,
    head: Sequence[str],
    rows: Sequence[Mapping[str, Any]],
    episodes: Sequence[Row],
) -> list[Path]:
    cells = [_cells(row) for row in rows]
    lines = [f"# {head[0]}", "", *head[1:], "", f"| {' | '.join(cells[0])} |"]
    lines.append(f"|{'---|' * len(cells[0])}")
    lines += [f"| {' | '.join(row.values())} |" for row in cells]
    files = [folder / f"suite.{end}" for end in ("md", "csv", "html")]
    text = "\n".join(lines) + "\n"
    write_atomically(files[0], lambda temporary: temporary.write_text(text))
    write_csv(files[1], rows)
    names = list(dict.fromkeys(name for row in episodes for name in row))
    every = [{name: row.get(name, "") for name in names} for row in episodes]
    write_csv(folder / "cases.csv", every)
    worst = [
        (f"Worst cases of {which}", table(_worst(part)))
        for which, part in _parts(episodes)
    ]
    write_page(files[2], head[0], head[1:], [("Results", table(cells)), *worst])
    return [*files, folder / "cases.csv"]


def _parts(episodes: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Episodes by policy and level."""
    parts: dict[str, list[Row]] = {}
    for row in episodes:
        parts.setdefault(f"{row['policy']}, {row['level']}", []).append(row)
    return list(parts.items())


def _worst(episodes: Sequence[Row]) -> list[dict[str, Any]]:
    """Crashes first, then timeouts, then the slowest."""
    order = sorted(
        episodes, key=lambda row: (-row["crashed"], row["parked"], -row["length"])
    )
    return [
        {
            "case": row["case"],
            "kind": row["kind"],
            "outcome": next(
                name
                for name in ("parked", "crashed", "timed_out", "diverged")
                if row[name]
            ).replace("_", " "),
            **{
                name: row[name]
                for name in ("length", "path", "gear_changes", "final_distance")
            },
        }
        for row in order[:WORST]
    ]
