"""The episodes of a Q-learning run: rolling means as a table and as a picture."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.policy.checkpoints import write_atomically
from q_presets import QLearningConfig

OUTCOMES = ("parked", "crashed", "timed_out")
POINTS = 1500  # of a curve in the picture


def rolling_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Means (n - window + 1,) of `window` consecutive values (n,); fewer if n is."""
    total = np.concatenate([[0.0], np.cumsum(values, dtype=float)])
    window = min(window, len(values))
    return (total[window:] - total[:-window]) / window if window else total[:0]


def write_metrics(
    folder: Path, config: QLearningConfig, episodes: dict[str, np.ndarray]
) -> Path:
    """Writes `metrics.csv`: for every seed a row per `window` episodes.

    Args:
        folder: of the run.
        config: its settings.
        episodes: `Run.episodes`.
    """
    rows: list[dict[str, Any]] = []
    for seed in range(config.num_seeds):
        count = int((episodes["outcome"][seed] >= 0).sum())
        for first in range(0, count, config.window):
            part = slice(first, min(first + config.window, count))
            outcome = episodes["outcome"][seed, part]
            row: dict[str, Any] = {
                "seed": seed,
                "episode": part.stop,
                "phase": "training" if part.stop <= config.episodes else "evaluation",
                "episode_return": float(episodes["episode_return"][seed, part].mean()),
                "length": float(episodes["length"][seed, part].mean()),
            }
            for number, name in enumerate(OUTCOMES):
                row[name] = float((outcome == number).mean())
            rows.append(row)
    text = io.StringIO(newline="")
    if rows:
        writer = csv.DictWriter(text, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    path = folder / "metrics.csv"
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))
    return path


def plot_returns(
    folder: Path, config: QLearningConfig, episodes: dict[str, np.ndarray]
) -> Path:
    """Draws rolling return and share parked of every seed to `learning_curve.png`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (returns, shares) = plt.subplots(
        2, 1, figsize=(8, 6), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    for seed in range(config.num_seeds):
        outcome = episodes["outcome"][seed]
        done = outcome >= 0
        colour = f"C{seed % 10}"
        for axes, values in (
            (returns, episodes["episode_return"][seed][done]),
            (shares, (outcome[done] == 0).astype(float)),
        ):
            mean = rolling_mean(values, config.window)
            stride = max(1, len(mean) // POINTS)
            at = np.arange(len(mean))[::stride] + min(config.window, len(values))
            axes.plot(
                at, mean[::stride], color=colour, linewidth=1.0, label=f"seed {seed}"
            )
    for axes in (returns, shares):
        axes.axvline(config.episodes, color="black", linestyle="--", linewidth=1.0)
        axes.grid(alpha=0.3)
    returns.axvline(
        np.nan, color="black", linestyle="--", linewidth=1.0, label="end of training"
    )
    returns.legend(loc="best", fontsize="small")
    returns.set(ylabel="return")
    returns.set_title(
        f"{config.preset}: means over {config.window} episodes "
        f"({config.episodes} training, {config.eval_episodes} evaluation)"
    )
    shares.set(xlabel="episode", ylabel="share parked", ylim=(-0.02, 1.02))
    path = folder / "learning_curve.png"
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=100))
    plt.close(figure)
    return path


def summary(config: QLearningConfig, episodes: dict[str, np.ndarray]) -> list[str]:
    """A line per seed about its last episodes: the evaluation, or a window without."""
    last = config.eval_episodes or config.window
    lines = []
    for seed in range(config.num_seeds):
        done = np.flatnonzero(episodes["outcome"][seed] >= 0)[-last:]
        if not len(done):
            continue
        outcome = episodes["outcome"][seed, done]
        rates = ", ".join(
            f"{name.replace('_', ' ')} {(outcome == number).mean():.1%}"
            for number, name in enumerate(OUTCOMES)
        )
        mean = episodes["episode_return"][seed, done].mean()
        lines.append(
            f"seed {seed}: last {len(done)} episodes: return {mean:.2f}, {rates}"
        )
    return lines
