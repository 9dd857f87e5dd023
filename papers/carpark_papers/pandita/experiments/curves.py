"""Learning curves of the experiments in slots, a panel for each."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from carpark_mj.training.curve import smooth
from carpark_mj.training.metrics_log import read_metrics
from carpark_mj.training.panels import make_panels, write_figure
from carpark_papers.pandita.experiments.slots import SlotsExperiment

WINDOW = 7  # rows of the moving average
THOUSAND = 1e3
TITLE_WIDTH = 40  # characters


def draw_curves(runs: Mapping[SlotsExperiment, Sequence[Path]]) -> Figure:
    """Success of the training's episodes over the steps, a line for each run.

    Dashed lines are the ends of phases.

    Args:
        runs: folders by experiment.
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
