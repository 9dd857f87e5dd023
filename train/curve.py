"""The learning curve of a run as a picture."""

from pathlib import Path

import numpy as np

from logger import read_metrics

OUTCOMES = (
    ("parked", "tab:green"),
    ("crashed", "tab:red"),
    ("timed_out", "tab:gray"),
)


def plot_learning_curve(folder: Path) -> Path:
    """Draws outcome rates and return over agent steps to `learning_curve.png`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [row for row in read_metrics(folder) if row["episodes"] > 0]
    steps = np.array([row["env_steps"] for row in rows]) / 1e6
    episodes = np.array([row["episodes"] for row in rows])
    figure, (rates, returns) = plt.subplots(
        2, 1, figsize=(8, 6), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    for name, colour in OUTCOMES:
        values = np.array([row[f"episode/{name}"] for row in rows])
        rates.plot(steps, values, color=colour, alpha=0.2, linewidth=0.8)
        rates.plot(
            steps, smooth(values, episodes), color=colour, label=name.replace("_", " ")
        )
    rates.set(ylabel="share of episodes", ylim=(0, 1))
    rates.grid(alpha=0.3)
    rates.legend(loc="center right")
    rates.set_title(f"{folder.name}: training episodes (stochastic policy)")
    values = np.array([row["episode/episode_return"] for row in rows])
    returns.plot(steps, values, color="tab:blue", alpha=0.2, linewidth=0.8)
    returns.plot(steps, smooth(values, episodes), color="tab:blue")
    returns.set(xlabel="agent steps [million]", ylabel="return")
    returns.grid(alpha=0.3)
    path = folder / "learning_curve.png"
    figure.savefig(path, dpi=120)
    plt.close(figure)
    return path


def smooth(values: np.ndarray, weights: np.ndarray, window: int = 21) -> np.ndarray:
    """Centred moving average, weighted; narrower at the ends."""
    if not len(values):  # a run so short that no episode ended
        return values
    kernel = np.ones(min(window, len(values)))
    total = np.convolve(values * weights, kernel, mode="same")
    return total / np.maximum(np.convolve(weights, kernel, mode="same"), 1e-9)
