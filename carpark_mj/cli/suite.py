"""What `python eval/suite.py` does: policies in the held-out cases, in one table."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from carpark_mj.cli.driver import find_driver
from carpark_mj.cli.suite_report import header, print_rows, write_results
from carpark_mj.config import ParkedRule
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import Row
from carpark_mj.evaluation.suite import (
    VEHICLE,
    Cases,
    decision_time,
    drive_cases,
    pick_cases,
    suite_env,
    table_rows,
)
from carpark_mj.layouts import Layout
from carpark_mj.layouts.held_out import CASES, LEVELS
from carpark_mj.layouts.standards import Level
from carpark_mj.planning.paths import Path, car_of
from carpark_mj.planning.plot import plot_paths
from carpark_mj.planning.policy import Planner, planner_policy
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.policy.checkpoints import require_writable
from carpark_mj.vehicle import preset

PLANNER = "planner"
DRAWN = 4  # cases of each level in the picture of paths


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
        out: folder for `suite.md`, `suite.csv`, `cases.csv`, `suite.html` and,
            of the planner, `paths.png`.
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
    folder = pathlib.Path(config.out)
    folder.mkdir(parents=True, exist_ok=True)
    require_writable(folder / "suite.csv")  # refused before the work
    drivers = {name: find_driver(name) for name in config.policies}
    cases = [pick_cases(level, config.cases) for level in config.levels]
    # The planner first: others are compared with its paths.
    names = sorted(config.policies, key=lambda name: name != PLANNER)
    rows: list[dict[str, Any]] = []
    episodes: list[Row] = []
    plans: dict[tuple[str, int], Row] = {}
    drawn: list[tuple[str, Layout, Path | None]] = []
    for name in names:
        env = ParkingEnv(suite_env(drivers[name].env, config.rule))
        own: list[Row] = []
        for part in cases:
            policy, planner = _policy(name, drivers[name].policy, env, config.seed)
            found = drive_cases(env, policy, part, config.seed)
            if planner is not None:
                plans |= _plans(planner, part)
                drawn += _drawn(planner, part)
            key = [(row["level"], row["case"]) for row in found]
            found = [
                row | plans.get(which, {})
                for row, which in zip(found, key, strict=True)
            ]
            seconds = _seconds(env, policy, planner, part)
            own += [row | {"ms / decision": 1e3 * seconds} for row in found]
        rows += [_complete(row, own) for row in table_rows(name, own)]
        episodes += [{"policy": name} | row for row in own]
    head = header(config.rule, config.cases, config.seed)
    print_rows(rows, head[0])
    pictures = [folder / "paths.png"] if drawn else []
    for path in pictures:
        plot_paths(path, drawn, car_of(preset(VEHICLE)))
    written = write_results(folder, head, rows, episodes, pictures)
    print(f"wrote {', '.join(map(str, [*written, *pictures]))}")
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


def _drawn(planner: Planner, cases: Cases) -> list[tuple[str, Layout, Path | None]]:
    """Titles, layouts and paths of the first cases."""
    found: list[tuple[str, Layout, Path | None]] = []
    for lot, number in enumerate(cases.number[:DRAWN].tolist()):
        path = planner.searches(lot, 0)[0].path
        told = f"{path.length:.1f} m, {path.shifts} gear changes" if path else "no path"
        layout = jax.tree.map(lambda x, lot=lot: x[lot], cases.layouts)
        found.append((f"{cases.level} {number}: {told}", layout, path))
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
