"""Settings of tabular Q-learning: one frozen dataclass, and the study's experiments."""

import dataclasses
from typing import Literal

from carpark_mj.config import EnvConfig
from carpark_mj.registry import TANNER_QLEARNING, TANNER_QLEARNING_RINGS

QLearningPreset = Literal["tanner-qlearning", "tanner-qlearning-rings"]


@dataclasses.dataclass(frozen=True)
class QLearningConfig:
    """Settings of `python train/q_learning.py`; every field is a flag.

    The rates are those of Tanner 2022, section 5.1.1; names follow his table C.6.

    Attributes:
        preset: experiment the other flags start from: `tanner-qlearning`, figure 5.1,
            or `tanner-qlearning-rings`, figure 5.2.
        name: folder under `runs_dir`; empty = preset and seed.
        runs_dir: where runs are kept.
        resume: folder of a run to continue; its own settings hold.
        time_limit: stop with a checkpoint after so many minutes; 0 = no limit.
        seed: of everything.
        num_seeds: independent trainings side by side, each with its own table.
        num_lots: lots that share a table; 1 is faithful to the study, more is faster.
        episodes: training episodes of each seed, over which the rates fall.
        eval_episodes: further episodes without random actions, still learning.
        alpha: learning rate at the start.
        alpha_min: at the end of the training episodes.
        gamma: discount per control step.
        epsilon: share of random actions at the start.
        epsilon_min: at the end of the training episodes.
        bootstrap_terminals: value what an agent sees when it has parked or crashed
            as if it went on, as the study's program does; a slip.
        window: episodes over which the plot and the table of metrics average.
        checkpoint_minutes: time between checkpoints.
        env: the environment.
    """

    preset: QLearningPreset = "tanner-qlearning"
    name: str = ""
    runs_dir: str = "runs"
    resume: str = ""
    time_limit: float = 0.0
    seed: int = 0
    num_seeds: int = 5
    num_lots: int = 1
    episodes: int = 2000
    eval_episodes: int = 1000
    alpha: float = 0.1
    alpha_min: float = 0.1
    gamma: float = 0.9
    epsilon: float = 0.3
    epsilon_min: float = 0.001
    bootstrap_terminals: bool = False
    window: int = 500
    checkpoint_minutes: float = 1.0
    env: EnvConfig = TANNER_QLEARNING

    def __post_init__(self) -> None:
        for name in ("num_seeds", "num_lots", "episodes", "window"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        if self.eval_episodes < 0:
            raise ValueError(
                f"eval_episodes must be at least 0, not {self.eval_episodes}"
            )
        for name in ("alpha", "alpha_min", "gamma", "epsilon", "epsilon_min"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(
                    f"{name} must lie in [0, 1], not {getattr(self, name)}"
                )
        if not self.checkpoint_minutes > 0:
            raise ValueError(
                f"checkpoint_minutes must be positive, not {self.checkpoint_minutes}"
            )

    @property
    def total_episodes(self) -> int:
        """Of each seed, training and evaluation."""
        return self.episodes + self.eval_episodes


Q_PRESETS: dict[str, QLearningConfig] = {
    "tanner-qlearning": QLearningConfig(),
    "tanner-qlearning-rings": QLearningConfig(
        preset="tanner-qlearning-rings",
        episodes=300_000,
        eval_episodes=150_000,
        window=5000,
        env=TANNER_QLEARNING_RINGS,
    ),
}
