"""What `carpark_mj suite` does: policies in the held-out cases, in one table."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro

from carpark_mj.cli.driver import find_driver
from carpark_mj.config import EnvConfig, find_rules
from carpark_mj.config.checks import require_unset
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import Row
from carpark_mj.evaluation.keys import require_seed
from carpark_mj.files import require_writable
from carpark_mj.layouts import Layout
from carpark_mj.planning.paths import PlannedPath
from carpark_mj.planning.plot import plot_paths
from carpark_mj.planning.policy import Planner, planner_policy
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.suite.evaluation import (
    MOVING_CAR,
    VEHICLE,
    CaseEvaluator,
    Drives,
    suite_env,
    table_rows,
    worst_first,
)
from carpark_mj.suite.levels import (
    HOPE_LEVELS,
    TPCAP_LEVEL,
    Cases,
    case_numbers,
    fingerprint,
    level_env,
    pick_cases,
    require_aisle,
    require_alike,
    require_filmed,
)
from carpark_mj.suite.report import (
    WORST,
    Video,
    header,
    made_with,
    make_videos,
    parts_of,
    print_rows,
    require_gl,
    write_results,
)
from carpark_mj.suite.results import (
    Key,
    check_submission,
    key_of,
    leaderboard,
    read_runs,
    write_run,
    write_submission,
)
from carpark_mj.vehicle import preset

PLANNER = "planner"
DRIVING = ("levels", "cases", "first_case", "rule", "moving_car", "seeds")
DRAWN = 4  # cases of each of HOPE's levels in the picture of paths; all of TPCAP's


@dataclasses.dataclass(frozen=True)
class SuiteConfig:
    """Settings of `carpark_mj suite`.

    Attributes:
        policies: pretrained policies, run folders, checkpoint files, `planner`, `zero`
            or `random`.
        levels: levels to drive: HOPE's `normal`, `complex` and `extreme`; `tpcap`,
            TPCAP's 20 published cases; `busy`, where people, a cart or a car get in
            the way; or registered ones.
        cases: number of cases of each level; None = all from `first_case` on.
        first_case: first case of each level, from 0.
        rule: when a car counts as parked: tanner, strict, precise, metadrive, or a
            registered rule.
        moving_car: another car drives through the aisle of every case.
        seeds: of the planner's searches and of stochastic policies; each seed drives
            all cases.
        videos: number of worst cases to film for every policy and level, at most 10;
            needs off-screen OpenGL.
        combine: folders of this command; drives no case and combines their episodes in
            one table.
        check: a `suite.json`; drives no case and checks the file as an entry of the
            leaderboard.
        out: folder for `suite.md`, `suite.csv`, `suite.json`, `cases.csv`, `worst.npz`,
            `suite.html`, `videos/` and, of the planner, `paths.png`.
    """

    policies: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")
    ] = ()
    levels: tuple[str, ...] = HOPE_LEVELS
    cases: int | None = None
    first_case: int = 0
    rule: str = "strict"
    moving_car: bool = False
    seeds: tuple[int, ...] = (0,)
    videos: int = 0
    combine: tuple[str, ...] = ()
    check: str = ""
    out: str = "runs/suite"

    def __post_init__(self) -> None:
        if self.check:
            other = "with --check, which drives nothing"
            require_unset(self, other, "policies", "combine", "videos", *DRIVING)
        elif bool(self.policies) == bool(self.combine):
            raise ValueError(
                "name at least one policy, for example planner, or folders to combine"
                f"{', not both' if self.policies else ''}"
            )
        find_rules(self.rule)
        if self.combine:
            require_unset(self, "with --combine, which drives nothing", *DRIVING)
        require_alike(self.levels)
        for level in self.levels:
            self._check_cases(level)
            if self.videos:
                require_filmed(level)
            if self.moving_car:
                require_aisle(level)
        if not 0 <= self.videos <= WORST:
            raise ValueError(f"videos must be 0 to {WORST}, not {self.videos}")
        for name in ("policies", "levels", "seeds", "combine"):
            value = getattr(self, name)
            if len(set(value)) < len(value):
                raise ValueError(f"{name} must differ from each other, not {value}")
        for name in ("levels", "seeds"):
            if not getattr(self, name):
                raise ValueError(f"{name} must not be empty")
        for seed in self.seeds:
            require_seed(seed)

    def _check_cases(self, level: str) -> None:
        numbers = case_numbers(level)
        known = len(numbers)
        if not 0 <= self.first_case < known:
            raise ValueError(
                f"first_case must be 0 to {known - 1}, not {self.first_case}: level "
                f"{level} has the cases {numbers[0]} to {numbers[-1]}"
            )
        left = known - self.first_case
        if self.cases is not None and not 1 <= self.cases <= left:
            raise ValueError(
                f"cases must be 1 to {left} from case {self.first_case} on, not "
                f"{self.cases}: level {level} has {known}"
            )


def main(config: SuiteConfig) -> list[dict[str, Any]]:
    """Drives, writes the files and prints the table; returns the table's rows.

    With `check` it prints the leaderboard's rows, and returns none.

    Raises:
        CheckpointError: a run cannot be read.
        RenderingError: videos are requested without OpenGL.
        ValueError: impossible settings, or malformed results to combine.
        OSError: the output folder cannot be written.
    """
    if config.check:
        print(leaderboard(check_submission(Path(config.check))))
        return []
    folder = Path(config.out)
    if folder.resolve() in [Path(name).resolve() for name in config.combine]:
        raise ValueError(f"out must not be one of the combined folders, {config.out}")
    if config.videos:
        require_gl()
    require_writable(folder / "suite.csv", new_folders=True)  # refused before the work
    drawn: _Drawn = []
    if config.combine:
        episodes, drives = read_runs([Path(name) for name in config.combine])
    else:
        print("compiling ...", flush=True)
        episodes, drives, drawn = _drive_all(config)
    if config.videos:  # of combined folders
        for level in {row["level"] for row in episodes}:
            require_filmed(level)
    folder.mkdir(parents=True, exist_ok=True)
    pictures: list[Path] = []
    if drawn:
        pictures.append(folder / "paths.png")
        plot_paths(pictures[0], drawn, preset(VEHICLE))
    # The planner first: others are compared with its paths.
    names = sorted({row["policy"] for row in episodes}, key=lambda n: (n != PLANNER, n))
    rows = [row for name in names for row in table_rows(name, episodes)]
    head = header(episodes)
    written = [*write_run(folder, episodes, drives), write_submission(folder, episodes)]
    written += write_results(folder, head, rows, episodes, pictures, ())
    print_rows(rows, head[0])
    videos: list[Video] = []
    for part in parts_of(episodes).values():
        videos += make_videos(folder, worst_first(part)[: config.videos], drives)
    if videos:  # once more, with them
        write_results(folder, head, rows, episodes, pictures, videos)
    print(f"wrote {', '.join(map(str, [*written, *pictures]))}")
    return rows


_Drawn = list[tuple[str, Layout, PlannedPath | None]]


def _drive_all(config: SuiteConfig) -> tuple[list[Row], dict[Key, Drives], _Drawn]:
    """Episodes, the driven paths of the worst ones, and the planner's first paths."""
    drivers = {name: find_driver(name) for name in config.policies}
    first, moving = config.first_case, config.moving_car

    def env_of(name: str, level: str) -> EnvConfig:
        base = suite_env(drivers[name].env, config.rule, moving)
        return level_env(level, base)

    for name, driver in drivers.items():  # all are refused before one of them drives
        for env_config in {env_of(name, level) for level in config.levels}:
            driver.policy(ParkingEnv(env_config))
    cases = [
        pick_cases(
            level, config.cases or len(case_numbers(level)) - first, first, moving
        )
        for level in config.levels
    ]
    tail = {"made_with": made_with()}
    episodes: list[Row] = []
    drives: dict[Key, Drives] = {}
    drawn: _Drawn = []
    evaluators: dict[EnvConfig, CaseEvaluator] = {}
    policies: dict[tuple[str, EnvConfig], tuple[AnyPolicy, Planner | None]] = {}
    for name, driver in drivers.items():
        for seed in config.seeds:
            for part in cases:
                env_config = env_of(name, part.level)
                if env_config not in evaluators:
                    evaluators[env_config] = CaseEvaluator(ParkingEnv(env_config))
                evaluator, key = evaluators[env_config], (name, env_config)
                if key not in policies:
                    policies[key] = _policy(name, driver.policy, evaluator.env)
                policy, planner = policies[key]
                if planner is not None:
                    planner.reset(seed, first)
                rows, driven = evaluator.drive(policy, part, seed)
                if planner is not None:
                    plans = _plans(planner, len(rows))
                    rows = [row | own for row, own in zip(rows, plans, strict=True)]
                    if seed == config.seeds[0]:
                        drawn += _drawn(planner, part)
                    seconds = planner.seconds / planner.decisions
                else:
                    seconds = evaluator.decision_time(policy, part)
                own = {"ms / decision": 1e3 * seconds} | tail
                which = {"policy": name, "seed": seed, "rule": config.rule}
                which |= {"held_out": fingerprint(part.level)}
                which |= {MOVING_CAR: 1} if moving else {}
                rows = [which | row | own for row in rows]
                episodes += rows
                drives |= _worst_drives(rows, driven)
    return episodes, drives, drawn


def _policy(
    name: str, make: Callable[[ParkingEnv], AnyPolicy], env: ParkingEnv
) -> tuple[AnyPolicy, Planner | None]:
    return planner_policy(env) if name == PLANNER else (make(env), None)


def _worst_drives(rows: list[Row], driven: Drives) -> dict[Key, Drives]:
    """Driven paths of the worst of some episodes, which are numbered as the drives."""
    numbers = {key_of(row): number for number, row in enumerate(rows)}
    kept: dict[Key, Drives] = {}
    for row in worst_first(rows)[:WORST]:
        number, length = numbers[key_of(row)], round(row["length"])
        kept[key_of(row)] = Drives(*(x[[number], :length] for x in driven))
    return kept


def _plans(planner: Planner, lots: int) -> list[Row]:
    """Results of the planner's first search in every lot."""
    found: list[Row] = []
    for lot in range(lots):
        first = planner.searches(lot, 0)[0]
        length = first.path.length if first.path else math.nan
        planned = {"planned": float(first.path is not None), "planned_path": length}
        found.append(planned | {"planning_seconds": first.seconds})
    return found


def _drawn(planner: Planner, cases: Cases) -> _Drawn:
    """Titles, layouts and paths of the cases in the picture."""
    found: _Drawn = []
    count = None if cases.level == TPCAP_LEVEL else DRAWN
    for lot, number in enumerate(cases.number[:count].tolist()):
        path = planner.searches(lot, 0)[0].path
        told = f"{path.length:.1f} m, {path.shifts} gear changes" if path else "no path"
        layout = jax.tree.map(lambda x, lot=lot: x[lot], cases.layouts)
        found.append((f"{cases.level} {number}: {told}", layout, path))
    return found
