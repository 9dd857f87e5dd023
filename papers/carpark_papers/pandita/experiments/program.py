"""Repeats the experiments of Pandita 2022 over seeds and compares with the thesis.

    carpark_mj study slots --list
    carpark_mj study slots --experiment 10
    carpark_mj study slots --all --minutes 9      # continues when repeated
    carpark_mj study slots --all --preset pandita # the thesis's settings

Every training is a run of `carpark_mj study sac` in `runs/slots_study`, on its own
core. `report.md` there has the finished runs, `matrix-NAME.png` success by phase and
kind of lot, `curves.png` success in training.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.config.checks import Positive
from carpark_papers.jobs import Job, RepeatConfig
from carpark_papers.pandita.experiments.slots import (
    EXPERIMENTS,
    SlotsExperiment,
    make_job,
    slots_experiment,
)
from carpark_papers.pandita.sac.config import SACPreset


@dataclasses.dataclass(frozen=True)
class SlotsStudyConfig(RepeatConfig):
    """Settings of `carpark_mj study slots`.

    The settings of `RepeatConfig` come first.

    Attributes:
        experiment: number of an experiment, or name of one beyond the thesis.
        preset: preset of `carpark_mj study sac`.
        scale: factor on the thesis's budgets of steps.
    """

    runs_dir: str = "runs/slots_study"
    experiment: str = ""
    preset: SACPreset = "study"
    scale: Positive = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.experiment) + self.all + self.list != 1:
            raise ValueError("give one of --experiment NAME, --all and --list")


def describe() -> None:
    """Prints a line per experiment."""
    for experiment in EXPERIMENTS:
        phases = ", then ".join(experiment.phases(1.0))
        print(f"{experiment.name:12} {experiment.title}: {phases} steps")


def report(folder: Path, jobs: dict[SlotsExperiment, list[Job]]) -> Path:
    """Writes the table, the matrices and the learning curves of finished runs."""
    from carpark_papers.pandita.experiments.report import (
        read_deployments,
        write_curves,
        write_matrix,
        write_report,
    )

    done = {
        experiment: [job for job in runs if job.is_done]
        for experiment, runs in jobs.items()
    }
    done = {experiment: runs for experiment, runs in done.items() if runs}
    results = {
        experiment: [read_deployments(job) for job in runs]
        for experiment, runs in done.items()
    }
    path = folder / "report.md"
    write_report(path, results)
    for experiment, runs in results.items():
        write_matrix(folder / f"matrix-{experiment.name}.png", experiment, runs)
    folders = {
        experiment: [job.folder for job in runs] for experiment, runs in done.items()
    }
    if folders:
        write_curves(folder / "curves.png", folders)
    return path


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs experiments; returns the exit code, 1 if runs have failed."""
    from carpark_mj.cli.flags import read_flags

    config = read_flags(SlotsStudyConfig, arguments, description=__doc__)
    if config.list:
        describe()
        return 0
    wanted = EXPERIMENTS if config.all else (slots_experiment(config.experiment),)
    folder = Path(config.runs_dir)
    jobs = {
        experiment: [
            make_job(experiment, config.preset, config.scale, seed, folder)
            for seed in range(config.seeds)
        ]
        for experiment in wanted
    }
    # Long ones first; experiments that train alike have one job.
    budget = {
        job.folder: (sum(count for _, count in experiment.stages), job)
        for experiment, runs in jobs.items()
        for job in runs
    }
    order = sorted(budget.values(), key=lambda pair: -pair[0])
    return config.repeat([job for _, job in order], lambda: report(folder, jobs))
