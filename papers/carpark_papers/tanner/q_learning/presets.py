"""The Q-learning experiments of Tanner 2022."""

from carpark_papers.tanner.environments import (
    TANNER_QLEARNING_RECORDED,
    TANNER_QLEARNING_RINGS,
)
from carpark_papers.tanner.q_learning.config import QLearningConfig

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
