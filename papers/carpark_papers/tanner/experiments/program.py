"""Repeats the experiments of Tanner 2022 and compares with the published numbers.

    carpark_mj study tanner --list
    carpark_mj study tanner --figure 5.8                 # its sweep, table and plots
    carpark_mj study tanner --all --minutes 60           # what fits into an hour
    carpark_mj study tanner --figure 5.5 --cluster slurm

Every figure has a folder below `runs/study`: a sweep (`carpark_mj sweep`),
`report.html` with the published runs drawn in, and `verdicts.md`. Repeating the command
continues.
"""

import dataclasses
import statistics
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.analysis import group, run_folders
from carpark_mj.cli.settings.tables import Cluster, Where
from carpark_mj.config.checks import CheckedConfig, Count, Natural, NonNegative
from carpark_mj.sweeps import read_outcome
from carpark_mj.sweeps.plan import Plan, Run, groups, settings_of
from carpark_papers.tanner.experiments.figures import (
    ELSEWHERE,
    EXPERIMENTS,
    FIGURES,
    SOURCE,
    Experiment,
    experiment_of,
    plan_of,
    published_runs,
    write_verdicts,
)


@dataclasses.dataclass(frozen=True)
class StudyConfig(CheckedConfig):
    """Settings of `carpark_mj study tanner`.

    Attributes:
        figure: number of a figure, `5.8`.
        all: all figures, the fewest programs first.
        list: list the figures and train none.
        minutes: budget [min]; figures that do not fit are named and left out. 0 = no
            limit.
        repeats: runs of every combination; 0 = as many as published.
        seed: first seed.
        set: settings of all runs instead of the study's, `FIELD=VALUE` as in
            `carpark_mj sweep`.
        runs_dir: folder of the sweeps.
        cluster: see `carpark_mj sweep`.
        jobs: see `carpark_mj sweep`.
        side_by_side: see `carpark_mj sweep`.
        slurm: see `carpark_mj sweep`.
    """

    figure: str = ""
    all: bool = False
    list: bool = False
    minutes: NonNegative = 0.0
    repeats: Natural = 0
    seed: Natural = 0
    set: tuple[str, ...] = ()
    runs_dir: str = "runs/study"
    cluster: Cluster = "local"
    jobs: Natural = 0
    side_by_side: Count = 8
    slurm: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.figure) + self.all + self.list != 1:
            raise ValueError("give one of --figure NUMBER, --all and --list")

    @property
    def where(self) -> Where:
        """Settings of the executor; the study samples actions."""
        return Where(
            cluster=self.cluster,
            jobs=self.jobs,
            side_by_side=self.side_by_side,
            slurm=self.slurm,
            stochastic=True,
        )


# NVIDIA H200, docs/study.md: 16 M steps of seven agents in 66 to 75 s; compiling and
# evaluation take as long as that again.
STEPS_PER_SECOND = 110_000.0


@dataclasses.dataclass(frozen=True)
class Cost:
    """Remaining cost of an experiment."""

    experiment: Experiment  # the experiment
    runs: int  # number of its runs
    left: int  # number of unfinished runs
    programs: int  # number of programs that train these, several side by side
    minutes: float  # estimated time of these, one at a time [min]


def cost(
    experiment: Experiment,
    runs: Sequence[Run],
    folder: Path,
    rate: float,
    side_by_side: int = 1,
) -> Cost:
    """Estimates an experiment, at a rate in agent steps per second with evaluation."""
    left = [run for run in runs if read_outcome(folder, run).status != "done"]
    seconds = settings_of(left[0]).num_steps / rate * len(left) if left else 0.0
    programs = len(groups(left, side_by_side))
    return Cost(experiment, len(runs), len(left), programs, seconds / 60.0)


def measured_rate(sweeps: Sequence[tuple[Path, Sequence[Run]]]) -> float:
    """Agent steps per second of the runs that are done; an H200's without any."""
    rates: list[float] = []
    for folder, runs in sweeps:
        done = [run for run in runs if read_outcome(folder, run).status == "done"]
        steps = settings_of(done[0]).num_steps if done else 0
        rates += [steps / max(read_outcome(folder, run).seconds, 1e-3) for run in done]
    return statistics.median(rates) if rates else STEPS_PER_SECOND


def choose(
    costs: Sequence[Cost], minutes: float, at_once: int = 1
) -> tuple[list[Cost], list[Cost]]:
    """Experiments that fit a budget, fewest programs first, and the remaining ones.

    The budget is in minutes, 0 = no limit, for `at_once` runs at a time.
    """
    chosen: list[Cost] = []
    rest: list[Cost] = []
    for one in sorted(costs, key=lambda cost: cost.programs):
        spent = sum(c.minutes for c in chosen) / at_once
        fits = not minutes or spent + one.minutes / at_once <= minutes
        (chosen if fits else rest).append(one)
    return chosen, rest


def describe() -> None:
    """Prints a line per figure."""
    for figure in FIGURES:
        if figure in ELSEWHERE:
            print(f"{figure:5} {ELSEWHERE[figure]}")
            continue
        experiment = experiment_of(figure)
        note = f"; {experiment.note}" if experiment.note else ""
        print(
            f"{figure:5} {experiment.title}: {experiment.base}, "
            f"{' x '.join(experiment.fields)}, {len(plan_of(experiment))} runs{note}"
        )


def report(experiment: Experiment, folder: Path) -> Path | None:
    """Writes the page and the verdicts of finished runs; None without any."""
    from carpark_mj.cli.analysis import analyse, read_records

    records, missing = read_records(run_folders([folder]))
    if not records:
        return None
    sources = {"ours": records, SOURCE: published_runs(experiment.figures)}
    title = f"Figure {', '.join(experiment.figures)}: {experiment.title}"
    note = f"Reading: {experiment.note}." if experiment.note else ""
    notes = [text for text in (note, *missing) if text]
    page = analyse(sources, experiment.fields, experiment.metrics, folder, title, notes)
    write_verdicts(
        folder / "verdicts.md",
        group(sources, experiment.fields),
        experiment.fields,
        experiment.metrics,
    )
    return page


def say_budget(chosen: Sequence[Cost], rest: Sequence[Cost], minutes: float) -> None:
    """Prints which experiments run and which are left out."""
    for words, costs in (("runs", chosen), ("leaves out", rest)):
        for one in costs:
            print(
                f"{words} figure {', '.join(one.experiment.figures)}: {one.left} of "
                f"{one.runs} runs in {one.programs} programs, about "
                f"{one.minutes:.0f} min one at a time"
            )
    if rest:
        print(f"{len(rest)} experiments do not fit {minutes:g} minutes")


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the study; returns the exit code, 1 if runs have failed."""
    from carpark_mj.cli.flags import read_flags
    from carpark_mj.sweeps import prepare, run_sweep
    from carpark_mj.sweeps.plan import checked_runs, read_axis
    from carpark_mj.training.ppo.parts import PRESETS

    config = read_flags(StudyConfig, arguments, description=__doc__)
    if config.list:
        describe()
        return 0
    wanted = EXPERIMENTS if config.all else (experiment_of(config.figure),)
    prepare(config.cluster)
    work: dict[str, tuple[Experiment, Plan, list[Run], Path]] = {}
    for experiment in wanted:
        changes = tuple(read_axis(x, PRESETS[experiment.base]) for x in config.set)
        if several := [axis.fields[0] for axis in changes if axis.is_swept]:
            raise ValueError(f"set takes one value each, not several of {several[0]}")
        plan = plan_of(experiment, config.repeats, config.seed, changes)
        folder = Path(config.runs_dir) / experiment.name
        work[experiment.name] = experiment, plan, checked_runs(plan), folder
    rate = measured_rate([(folder, runs) for _, _, runs, folder in work.values()])
    costs = [
        cost(each, runs, folder, rate, config.side_by_side)
        for each, _, runs, folder in work.values()
    ]
    chosen, rest = choose(costs, config.minutes, config.jobs or 1)
    say_budget(chosen, rest, config.minutes)
    failed = 0
    for one in chosen:
        experiment, plan, runs, folder = work[one.experiment.name]
        failed += run_sweep(folder, plan, runs, config.where)["failed"]
        report(experiment, folder)
    return 1 if failed else 0
