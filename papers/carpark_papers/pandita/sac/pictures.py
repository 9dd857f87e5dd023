"""Learning curve and success matrix of a SAC run as pictures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carpark_mj.files import write_atomically
from carpark_mj.training.loop import plot_learning_curve, read_metrics

_RATES = (("success", "tab:green"), ("crashed", "tab:red"), ("timed_out", "tab:gray"))


def plot_phases(folder: Path) -> Path:
    """Draws rates and return of the training's episodes to `learning_curve.png`."""
    ends = {row["phase"]: row["env_steps"] for row in read_metrics(folder)}
    return plot_learning_curve(
        folder,
        _RATES,
        "return",
        ("steps of cars [thousand]", 1e3),
        window=7,
        switches=sorted(ends.values())[:-1],
    )


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
        axes.imshow(matrix, cmap="RdYlGn", vmin=-0.3, vmax=1.3, aspect="auto")
        for (row, column), value in np.ndenumerate(matrix):
            axes.text(column, row, f"{value:.0%}", ha="center", va="center")
        axes.set_xticks(range(len(kinds)), kinds)
        axes.set_yticks(range(len(phases)), phases)
        axes.set(xlabel="deployed on", ylabel="after", title="success rate")
        write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120))
    finally:
        plt.close(figure)
    return path
