"""Repeats the experiments of Tanner 2022, beside the published numbers.

    carpark_mj study tanner --list
    carpark_mj study tanner --figure 5.8                 # its sweep, table and plots
    carpark_mj study tanner --all --minutes 60           # what fits, and what does not
    carpark_mj study tanner --figure 5.5 --cluster slurm

Every figure has a folder below `runs/study`: a sweep (`carpark_mj sweep`),
`report.html` with the published runs drawn in, and `verdicts.md`. The same command
continues.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from carpark_mj.analysis.points import group
from carpark_mj.analysis.runs import run_folders
from carpark_papers.tanner.experiments.published import SOURCE, published_runs
from carpark_papers.tanner.experiments.verdicts import write_verdicts

if TYPE_CHECKING:  # they load what `run_command` reports if it is missing
    from carpark_mj.sweeps.plan import Plan, Run
    from carpark_papers.tanner.experiments.budget import Cost
    from carpark_papers.tanner.experiments.figures import Experiment


def describe() -> None:
    """Prints a line per figure."""
    from carpark_papers.tanner.experiments.figures import (
        ELSEWHERE,
        FIGURES,
        experiment_of,
        plan_of,
    )

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


def report(experiment: "Experiment", folder: Path) -> Path | None:
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


def say_budget(
    chosen: "Sequence[Cost]", rest: "Sequence[Cost]", minutes: float
) -> None:
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
    from carpark_mj.sweeps.axes import read_axis
    from carpark_mj.sweeps.manage import run_sweep
    from carpark_mj.sweeps.plan import checked_runs
    from carpark_mj.sweeps.work import prepare
    from carpark_mj.training.ppo.parts import PRESETS
    from carpark_papers.tanner.experiments.budget import choose, cost, measured_rate
    from carpark_papers.tanner.experiments.config import StudyConfig
    from carpark_papers.tanner.experiments.figures import (
        EXPERIMENTS,
        experiment_of,
        plan_of,
    )

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
