"""Repeats tables 6.1 to 6.4 of Cederle 2023 over seeds and compares with the thesis.

    carpark_mj study junction_tables --list
    carpark_mj study junction_tables --table 6.1
    carpark_mj study junction_tables --all --minutes 30     # continues when repeated
    carpark_mj study junction_tables --all --preset cederle # the thesis's settings

Every training is a run of `carpark_mj study junction` in `runs/junction_study`, on its
own core. `report.md` there has tables and conclusions of all finished runs,
`curves-SCENARIO.png` the learning curves over the published ones.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from carpark_papers.cederle.experiments.runs import CELLS, SCENARIOS, cells_of
from carpark_papers.cederle.training.config import JunctionPreset
from carpark_papers.jobs import RepeatConfig


@dataclasses.dataclass(frozen=True)
class JunctionStudyConfig(RepeatConfig):
    """Settings of `carpark_mj study junction_tables`.

    The settings of `RepeatConfig` come first.

    Attributes:
        table: number of a table in the thesis.
        preset: preset of `carpark_mj study junction`; `ippo` and `mappo` have
            `parallel` only.
    """

    runs_dir: str = "runs/junction_study"
    table: str = ""
    preset: JunctionPreset = "parallel"

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.table) + self.all + self.list != 1:
            raise ValueError("give one of --table NUMBER, --all and --list")


def describe() -> None:
    """Prints a line per cell."""
    from carpark_papers.cederle.experiments.report import thesis

    for cell in CELLS:
        said = thesis(cell.published)
        print(f"{cell.table}  {cell.scenario:7} {cell.name:15} {said}")


def report(config: JunctionStudyConfig) -> Path:
    """Writes tables and learning curves of all finished runs."""
    from carpark_papers.cederle.experiments.report import write_curves, write_report
    from carpark_papers.cederle.experiments.runs import make_job, read_outcome

    folder = Path(config.runs_dir)
    done = {
        cell: [
            read_outcome(job.folder)
            for job in (
                make_job(cell, config.preset, seed, folder)
                for seed in range(config.seeds)
            )
            if job.is_done
        ]
        for cell in CELLS
    }
    done = {cell: outcomes for cell, outcomes in done.items() if outcomes}
    for table, name in SCENARIOS.items():
        runs = {cell: found for cell, found in done.items() if cell.table == table}
        if runs:
            write_curves(folder / f"curves-{name}.png", runs)
    path = folder / "report.md"
    write_report(path, done)
    return path


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the cells of tables; returns the exit code, 1 if runs have failed."""
    from carpark_mj.cli.flags import read_flags
    from carpark_papers.cederle.experiments.runs import make_job

    config = read_flags(JunctionStudyConfig, arguments, description=__doc__)
    if config.list:
        describe()
        return 0
    folder = Path(config.runs_dir)
    wanted = CELLS if config.all else cells_of(config.table)
    # Long ones first: physical cars, then more of them.
    order = sorted(wanted, key=lambda cell: (cell.cars == "mjx", cell.table))[::-1]
    jobs = [
        make_job(cell, config.preset, seed, folder)
        for cell in order
        for seed in range(config.seeds)
    ]
    return config.repeat(jobs, lambda: report(config))
