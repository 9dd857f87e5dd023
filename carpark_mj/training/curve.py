"""The learning curve of a run as a picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carpark_mj.training.figure import NAME, two_panels
from carpark_mj.training.metrics_log import read_metrics

OUTCOMES = (
    ("parked", "tab:green"),
    ("crashed", "tab:red"),
    ("timed_out", "tab:gray"),
)


def plot_learning_curve(
    folder: Path,
    outcomes: Sequence[tuple[str, str]] = OUTCOMES,
    returns: str = "episode_return",
    unit: tuple[str, float] = ("agent steps [million]", 1e6),
    window: int = 21,
    switches: Sequence[float] = (),
) -> Path:
    """Draws outcome rates and return over the steps to `learning_curve.png`.

    Args:
        folder: of the run.
        outcomes: columns under `episode/` with rates, and their colours.
        returns: the column with the return.
        unit: name and size of the unit of steps.
        window: rows of the moving average.
        switches: steps at which a phase of the training ended.
    """
    rows = [row for row in read_metrics(folder) if row["episodes"] > 0]
    label, size = unit
    steps = np.array([row["env_steps"] for row in rows]) / size
    episodes = np.array([row["episodes"] for row in rows])
    title = f"{folder.name}: training episodes (stochastic policy)"
    with two_panels(folder, title, label) as (tall, low):
        for axes, name, colour in (
            *((tall, name, colour) for name, colour in outcomes),
            (low, returns, "tab:blue"),
        ):
            values = np.array([row[f"episode/{name}"] for row in rows])
            mean = smooth(values, episodes, window)
            axes.plot(steps, values, color=colour, alpha=0.2, linewidth=0.8)
            axes.plot(steps, mean, color=colour, label=name.replace("_", " "))
        for axes in (tall, low):
            for switch in switches:
                axes.axvline(
                    switch / size, color="black", linestyle="--", linewidth=0.8
                )
        tall.set(ylabel="share of episodes", ylim=(0, 1))
        tall.legend(loc="center right")
        low.set(ylabel="return")
    return folder / NAME


def smooth(values: np.ndarray, weights: np.ndarray, window: int = 21) -> np.ndarray:
    """Centred moving average, weighted; narrower at the ends."""
    if not len(values):  # a run so short that no episode ended
        return values
    kernel = np.ones(min(window, len(values)))
    total = np.convolve(values * weights, kernel, mode="same")
    return total / np.maximum(np.convolve(weights, kernel, mode="same"), 1e-9)
