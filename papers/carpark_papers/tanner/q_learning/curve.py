"""The episodes of a Q-learning run: rolling means as a table and as a picture."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.files import write_csv
from carpark_mj.training.figure import NAME, two_panels
from carpark_mj.types import OUTCOMES
from carpark_papers.tanner.q_learning.config import QLearningConfig

POINTS = 1500  # of a curve in the picture


def rolling_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Means (n - window + 1,) of `window` consecutive values (n,); fewer if n is."""
    total = np.concatenate([[0.0], np.cumsum(values, dtype=float)])
    window = min(window, len(values))
    return (total[window:] - total[:-window]) / window if window else total[:0]


def write_metrics(
    folder: Path, config: QLearningConfig, episodes: dict[str, np.ndarray]
) -> Path:
    """Writes `metrics.csv`: for every seed a row per `window` episodes of a phase.

    Args:
        folder: of the run.
        config: its settings.
        episodes: `Run.episodes`.
    """
    rows: list[dict[str, Any]] = []
    for seed in range(config.num_seeds):
        count = int((episodes["outcome"][seed] >= 0).sum())
        for part in _windows(config, count):
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
    path = folder / "metrics.csv"
    write_csv(path, rows)
    return path


def _windows(config: QLearningConfig, count: int) -> Iterator[slice]:
    """The first `count` episodes by `window`; none holds episodes of both phases."""
    trained = min(count, config.episodes)
    for begin, end in ((0, trained), (trained, count)):
        for first in range(begin, end, config.window):
            yield slice(first, min(first + config.window, end))


def plot_returns(
    folder: Path, config: QLearningConfig, episodes: dict[str, np.ndarray]
) -> Path:
    """Draws rolling return and share parked of every seed to `learning_curve.png`."""
    title = (
        f"{config.preset}: means over {config.window} episodes "
        f"({config.episodes} training, {config.eval_episodes} evaluation)"
    )
    with two_panels(folder, title, "episode") as (returns, shares):
        for seed in range(config.num_seeds):
            outcome = episodes["outcome"][seed]
            done = outcome >= 0
            for axes, values in (
                (returns, episodes["episode_return"][seed][done]),
                (shares, (outcome[done] == 0).astype(float)),
            ):
                mean = rolling_mean(values, config.window)
                stride = max(1, len(mean) // POINTS)
                at = np.arange(len(mean))[::stride] + min(config.window, len(values))
                label = f"seed {seed}"
                axes.plot(
                    at, mean[::stride], f"C{seed % 10}", linewidth=1.0, label=label
                )
        for axes in (returns, shares):
            axes.axvline(
                config.episodes, color="black", linestyle="--", label="end of training"
            )
        returns.legend(loc="best", fontsize="small")
        returns.set(ylabel="return")
        shares.set(ylabel="share parked", ylim=(-0.02, 1.02))
    return folder / NAME


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
