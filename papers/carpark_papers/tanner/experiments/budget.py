"""Durations of experiments, and the choice that fits a budget."""

import dataclasses
import statistics
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.sweeps.groups import groups
from carpark_mj.sweeps.outcomes import read_outcome
from carpark_mj.sweeps.plan import Run, settings_of
from carpark_papers.tanner.experiments.figures import Experiment

# NVIDIA H200, docs/study.md: 16 M steps of seven agents in 66 to 75 s; compiling and
# evaluation take as long as that again.
STEPS_PER_SECOND = 110_000.0


@dataclasses.dataclass(frozen=True)
class Cost:
    """Remaining cost of an experiment.

    Attributes:
        experiment: the experiment.
        runs: number of its runs.
        left: number of unfinished runs.
        programs: number of programs that train these, several side by side.
        minutes: estimated time of these, one at a time [min].
    """

    experiment: Experiment
    runs: int
    left: int
    programs: int
    minutes: float


def cost(
    experiment: Experiment,
    runs: Sequence[Run],
    folder: Path,
    rate: float,
    side_by_side: int = 1,
) -> Cost:
    """Estimates an experiment.

    Args:
        experiment: which.
        runs: its runs.
        folder: of its sweep.
        rate: agent steps per second of a run, evaluation included.
        side_by_side: most runs in one program.
    """
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
    """Experiments that fit a budget, fewest programs first, and those left out.

    Args:
        costs: of the experiments.
        minutes: budget [min]; 0 = no limit.
        at_once: runs at a time.
    """
    chosen: list[Cost] = []
    rest: list[Cost] = []
    for one in sorted(costs, key=lambda cost: cost.programs):
        spent = sum(c.minutes for c in chosen) / at_once
        fits = not minutes or spent + one.minutes / at_once <= minutes
        (chosen if fits else rest).append(one)
    return chosen, rest
