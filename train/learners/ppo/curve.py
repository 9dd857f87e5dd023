"""The learning curve of a PPO run as a picture."""

from pathlib import Path

import numpy as np

from learners.figure import NAME, two_panels
from learners.ppo.metrics_log import read_metrics

OUTCOMES = (
    ("parked", "tab:green"),
    ("crashed", "tab:red"),
    ("timed_out", "tab:gray"),
)


def plot_learning_curve(folder: Path) -> Path:
    """Draws outcome rates and return over agent steps to `learning_curve.png`."""
    rows = [row for row in read_metrics(folder) if row["episodes"] > 0]
    steps = np.array([row["env_steps"] for row in rows]) / 1e6
    episodes = np.array([row["episodes"] for row in rows])
    title = f"{folder.name}: training episodes (stochastic policy)"
    with two_panels(folder, title, "agent steps [million]") as (rates, returns):
        for axes, name, colour in (
            *((rates, name, colour) for name, colour in OUTCOMES),
            (returns, "episode_return", "tab:blue"),
        ):
            values = np.array([row[f"episode/{name}"] for row in rows])
            label = name.replace("_", " ")
            axes.plot(steps, values, color=colour, alpha=0.2, linewidth=0.8)
            axes.plot(steps, smooth(values, episodes), color=colour, label=label)
        rates.set(ylabel="share of episodes", ylim=(0, 1))
        rates.legend(loc="center right")
        returns.set(ylabel="return")
    return folder / NAME


def smooth(values: np.ndarray, weights: np.ndarray, window: int = 21) -> np.ndarray:
    """Centred moving average, weighted; narrower at the ends."""
    if not len(values):  # a run so short that no episode ended
        return values
    kernel = np.ones(min(window, len(values)))
    total = np.convolve(values * weights, kernel, mode="same")
    return total / np.maximum(np.convolve(weights, kernel, mode="same"), 1e-9)
