"""The experiments in slots as a table and as curves."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.files import write_atomically
from carpark_mj.reading import read_csv
from carpark_mj.training.loop import read_metrics, smooth
from carpark_papers.jobs import Job
from carpark_papers.pandita.experiments.slots import (
    DIAGONAL,
    PARALLEL,
    VERTICAL,
    Claim,
    SlotsExperiment,
)
from carpark_papers.pandita.sac.config import read_phase
from carpark_papers.pandita.sac.deploy import plot_matrix, success_matrix, transfer
from carpark_papers.reports import ENOUGH, always, make_panels, write_figure

WINDOW = 7  # rows of the moving average
THOUSAND = 1e3
TITLE_WIDTH = 40  # characters


def draw_curves(runs: Mapping[SlotsExperiment, Sequence[Path]]) -> Figure:
    """Success of the training's episodes over the steps, a line for each run's folder.

    Dashed lines are the ends of phases.
    """
    figure, panels = make_panels(
        len(runs), "steps [thousand]", "share of episodes that park"
    )
    for axes, (experiment, folders) in zip(panels, runs.items(), strict=True):
        for folder in folders:
            axes.plot(*_success(folder), color="tab:green", linewidth=1.0, alpha=0.7)
        ends = np.cumsum([count for _, count in experiment.stages])
        title = textwrap.fill(f"{experiment.name}: {experiment.title}", TITLE_WIDTH)
        axes.set_title(title, fontsize="small")
        axes.set(ylim=(-0.03, 1.03))
        scale = _last_step(folders) / ends[-1]
        for end in ends[:-1] * scale:
            axes.axvline(end, color="black", linestyle="--", linewidth=0.8)
    return figure


def write_curves(path: Path, runs: Mapping[SlotsExperiment, Sequence[Path]]) -> Path:
    """Writes `draw_curves` to a PNG."""
    return write_figure(path, draw_curves(runs))


def _success(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Steps [thousand] and the smoothed success of a run."""
    rows = [row for row in read_metrics(folder) if row["episodes"] > 0]
    steps, episodes, success = (
        np.array([row[name] for row in rows])
        for name in ("env_steps", "episodes", "episode/success")
    )
    return steps / THOUSAND, smooth(success, episodes, WINDOW)


def _last_step(folders: Sequence[Path]) -> float:
    """Steps of the longest run [thousand]."""
    return max(float(_success(folder)[0].max(initial=0.0)) for folder in folders)


KINDS = (VERTICAL, DIAGONAL, PARALLEL)

# Rows of `deployments.csv` of the runs, by experiment.
Results = Mapping[SlotsExperiment, Sequence[Sequence[dict[str, Any]]]]


def read_deployments(job: Job) -> list[dict[str, Any]]:
    """Rows of a finished run, with numbers parsed."""
    return [
        {
            name: text if name in ("kind", "policy") else row.number(name)
            for name, text in row.cells.items()
        }
        for row in read_csv(job.folder / "deployments.csv", "kind", "policy")
    ]


def verdict(claims: Sequence[Claim], success: Mapping[str, Sequence[float]]) -> str:
    """Whether the seeds agree with the thesis's claims about every kind.

    `success` has rates of the deterministic policies by kind, one for each seed.
    """
    if not claims:
        return "not tried in the thesis"
    seeds = min(len(success[claim.kind]) for claim in claims)
    if seeds < ENOUGH:
        return f"not decided: {seeds} seeds"
    found: list[str] = []
    for claim in claims:
        parks = always(success[claim.kind])
        if parks is not claim.parks:
            word = {True: "parks", False: "fails", None: "mixed"}[parks]
            found.append(f"{claim.kind} {word}")
    return f"differs: {', '.join(found)}" if found else "agrees"


def final_success(
    runs: Sequence[Sequence[dict[str, Any]]], policy: str
) -> dict[str, list[float]]:
    """Success rates after the last phase by kind, one for each run."""
    last = [success_matrix(rows, KINDS, policy)[-1] for rows in runs]
    return {kind: [row[k] for row in last] for k, kind in enumerate(KINDS)}


def write_report(path: Path, results: Results) -> None:
    """Writes a markdown table with a row per experiment."""
    head = ("experiment", "trained", "thesis", *KINDS, "backward transfer", "verdict")
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for experiment, runs in results.items():
        likeliest = final_success(runs, "deterministic")
        sampled = final_success(runs, "sampled")
        cells = [experiment.name, experiment.title, experiment.statement]
        cells += [_cell(likeliest[kind], sampled[kind]) for kind in KINDS]
        cells.append(_backward(experiment, runs))
        cells.append(verdict(experiment.claims, likeliest))
        lines.append(f"| {' | '.join(cells)} |")
    text = "\n".join(lines) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def write_matrix(
    path: Path, experiment: SlotsExperiment, runs: Sequence[Sequence[dict[str, Any]]]
) -> Path:
    """Draws the success matrix of an experiment, the mean of its seeds."""
    matrix = np.mean([success_matrix(rows, KINDS) for rows in runs], axis=0)
    names = ["untrained", *(kinds.replace(",", ", ") for kinds, _ in experiment.stages)]
    return plot_matrix(path, matrix, names, KINDS)


def _backward(
    experiment: SlotsExperiment, runs: Sequence[Sequence[dict[str, Any]]]
) -> str:
    """The mean backward transfer of the seeds, of several phases."""
    phases = [read_phase(text) for text in experiment.phases(1.0)]
    if len(phases) == 1:
        return ""
    found = [transfer(success_matrix(rows, KINDS), KINDS, phases) for rows in runs]
    return f"{np.mean([each.backward for each in found]):+.2f}"


def _cell(likeliest: Sequence[float], sampled: Sequence[float]) -> str:
    """The share of seeds with its interval, and that of sampled actions."""
    if not likeliest:
        return ""
    low, high = wilson_interval(sum(likeliest), len(likeliest))
    return (
        f"{np.mean(likeliest):.0%} ({low:.0%} to {high:.0%}), sampled "
        f"{np.mean(sampled):.0%}"
    )
