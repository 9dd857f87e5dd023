"""Learning curve and success matrix of a SAC run as pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carpark_mj.policy.checkpoints import write_atomically
from learners.figure import NAME, two_panels
from learners.ppo.curve import smooth
from learners.ppo.metrics_log import read_metrics

_RATES = (("success", "tab:green"), ("crashed", "tab:red"), ("timed_out", "tab:gray"))


def plot_learning_curve(folder: Path) -> Path:
    """Draws rates and return of the training's episodes to `learning_curve.png`."""
    rows = [row for row in read_metrics(folder) if row["episodes"] > 0]
    steps = np.array([row["env_steps"] for row in rows]) / 1e3
    episodes = np.array([row["episodes"] for row in rows])
    phase = np.array([row["phase"] for row in rows])
    title = f"{folder.name}: training episodes (stochastic policy)"
    with two_panels(folder, title, "steps of cars [thousand]") as (rates, returns):
        for axes, name, colour in (
            *((rates, name, colour) for name, colour in _RATES),
            (returns, "return", "tab:blue"),
        ):
            values = np.array([row[f"episode/{name}"] for row in rows])
            label = name.replace("_", " ")
            axes.plot(steps, values, color=colour, alpha=0.2, linewidth=0.8)
            axes.plot(steps, smooth(values, episodes, 7), color=colour, label=label)
        for axes in (rates, returns):
            for switch in steps[1:][np.diff(phase) > 0]:
                axes.axvline(switch, color="black", linestyle="--", linewidth=0.8)
        rates.set(ylabel="share of episodes", ylim=(0, 1))
        rates.legend(loc="center right")
        returns.set(ylabel="return")
    return folder / NAME


def plot_matrix(
    path: Path, matrix: np.ndarray, phases: Sequence[str], kinds: Sequence[str]
) -> Path:
    """Draws success rates (phases, kinds): a row per phase, a column per kind."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    size = (2.2 + 1.3 * len(kinds), 1.4 + 0.5 * len(phases))
    figure, axes = plt.subplots(figsize=size, layout="constrained")
    try:
        axes.imshow(matrix, cmap="RdYlGn", vmin=0, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(matrix):
            axes.text(column, row, f"{value:.0%}", ha="center", va="center")
        axes.set_xticks(range(len(kinds)), kinds)
        axes.set_yticks(range(len(phases)), phases)
        axes.set(xlabel="deployed on", ylabel="after", title="success rate")
        write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120))
    finally:
        plt.close(figure)
    return path
