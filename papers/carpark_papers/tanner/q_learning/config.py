"""Settings and presets of Q-learning in Tanner 2022."""

import dataclasses
from typing import Literal

from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import Count, Natural, Ratio
from carpark_papers.tanner.environments import (
    TANNER_QLEARNING,
    TANNER_QLEARNING_RECORDED,
    TANNER_QLEARNING_RINGS,
)

QLearningPreset = Literal[
    "tanner-qlearning", "tanner-qlearning-recorded", "tanner-qlearning-rings"
]


@dataclasses.dataclass(frozen=True)
class QLearningSettings(RunConfig):
    """Settings of `carpark_mj study q_learning` but those of the environment.

    The settings of `RunConfig` come first. Rates follow Tanner 2022, section 5.1.1,
    names its table C.6.

    Attributes:
        preset: experiment that sets the defaults: `tanner-qlearning`, figure 5.1 by the
            study's tables; `tanner-qlearning-recorded`, figure 5.1 as recorded;
            `tanner-qlearning-rings`, figure 5.2.
        num_seeds: independent trainings in parallel, each with its own table.
        num_lots: lots that share a table; 1 as in the study, more is faster.
        episodes: training episodes per seed, over which the rates decay.
        eval_episodes: further episodes without random actions, still learning.
        alpha: learning rate at the start.
        alpha_min: learning rate at the end of the training episodes.
        gamma: discount factor per control step.
        epsilon: share of random actions at the start.
        epsilon_min: share of random actions at the end of the training episodes.
        bootstrap_terminals: bootstrap after parking and crashing too, as the reference
            implementation does by mistake.
        window: episodes over which the plot and the table of metrics average.
    """

    preset: QLearningPreset = "tanner-qlearning"
    num_seeds: Count = 5
    num_lots: Count = 1
    episodes: Count = 2000
    eval_episodes: Natural = 1000
    alpha: Ratio = 0.1
    alpha_min: Ratio = 0.1
    gamma: Ratio = 0.9
    epsilon: Ratio = 0.3
    epsilon_min: Ratio = 0.001
    bootstrap_terminals: bool = False
    window: Count = 500

    @property
    def total_episodes(self) -> int:
        """Episodes of each seed, training and evaluation."""
        return self.episodes + self.eval_episodes


@dataclasses.dataclass(frozen=True)
class QLearningConfig(QLearningSettings):
    """Settings of `carpark_mj study q_learning`; every field is a flag.

    The settings of `QLearningSettings` come first.

    Attributes:
        env: the environment.
    """

    env: EnvConfig = TANNER_QLEARNING


Q_PRESETS: dict[str, QLearningConfig] = {
    "tanner-qlearning": QLearningConfig(),
    "tanner-qlearning-recorded": QLearningConfig(
        preset="tanner-qlearning-recorded",
        bootstrap_terminals=True,
        env=TANNER_QLEARNING_RECORDED,
    ),
    "tanner-qlearning-rings": QLearningConfig(
        preset="tanner-qlearning-rings",
        episodes=300_000,
        eval_episodes=150_000,
        window=5000,
        env=TANNER_QLEARNING_RINGS,
    ),
}

Q_SUMMARIES = {
    name: f"{figure}, {Q_PRESETS[name].total_episodes:,} episodes"
    for name, figure in (
        ("tanner-qlearning", "figure 5.1"),
        ("tanner-qlearning-recorded", "figure 5.1 as recorded"),
        ("tanner-qlearning-rings", "figure 5.2"),
    )
}
