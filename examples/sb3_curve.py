"""Shared by the Stable-Baselines3 examples: clock, learning curve, final rates."""

import time
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv

matplotlib.use("agg")
from matplotlib import pyplot as plt


class Curve(BaseCallback):
    """Records the success rate during training, and stops it when time is up.

    Attributes:
        points: minutes, steps, and the rate over the latest episodes.
    """

    def __init__(self, minutes: float, every: float = 0.25) -> None:
        """Starts with the training.

        Args:
            minutes: until training stops.
            every: minutes between points.
        """
        super().__init__()
        self.points: list[tuple[float, int, float]] = []
        self._minutes, self._every, self._begun = minutes, every, 0.0

    def _on_training_start(self) -> None:
        self._begun = time.perf_counter()

    def _on_step(self) -> bool:
        minutes = (time.perf_counter() - self._begun) / 60
        if minutes >= self._every * (len(self.points) + 1):
            recent = self.model.ep_success_buffer or [0.0]
            point = minutes, self.num_timesteps, float(np.mean(recent))
            self.points.append(point)
            print(f"{minutes:5.1f} min {point[1]:>10,} steps {point[2]:6.1%}")
        return minutes < self._minutes

    def progress_left(self, _: float) -> float:
        """Remaining share of the minutes, which learning rates follow."""
        if not self._begun:
            return 1.0
        gone = (time.perf_counter() - self._begun) / 60 / self._minutes
        return max(0.0, 1.0 - gone)

    def plot(self, path: Path, title: str) -> None:
        """Draws the rate over the steps."""
        figure, axes = plt.subplots(figsize=(6, 4))
        axes.plot([p[1] for p in self.points], [p[2] for p in self.points])
        axes.set(xlabel="steps", ylabel="rate of success", ylim=(0, 1), title=title)
        axes.grid(alpha=0.3)
        figure.savefig(path, dpi=120, bbox_inches="tight")


def rates(model: BaseAlgorithm, env: VecEnv, episodes: int) -> dict[str, float]:
    """Shares of outcomes of whole episodes of the deterministic policy."""
    ends: list[dict[str, Any]] = []

    def note(local: dict[str, Any], _: dict[str, Any]) -> None:
        if local["done"]:
            ends.append(local["info"])

    evaluate_policy(model, env, episodes, callback=note)
    return {
        name: float(np.mean([end[name] for end in ends]))
        for name in ("is_success", "crashed", "TimeLimit.truncated")
    }
