"""Settings of independent deep Q-learning by name."""

import dataclasses

from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.training.config import Algorithm

_PRESETS: dict[str, DQNConfig] = {
    "parallel": DQNConfig(),
    # Cederle 2023, section 5.3 and, where the text is silent, its program. Evaluations
    # vary the starts, or all of their episodes would be the same.
    "cederle": DQNConfig(
        preset="cederle",
        observation="image",
        jitter=0.0,
        num_junctions=1,
        total_steps=300_000,
        updates=1,
        batch_size=32,
        buffer_size=20_000,
        random_steps=32,
        optimizer="rmsprop",
        learning_rate=1e-4,
        target_period=1000,
        epsilon_end=0.01,
        epsilon_steps=200_000,
        eval_period=5000,
        eval_episodes=20,
    ),
}

DQN_SUMMARIES = {
    "parallel": "32 junctions at once, vectors, a small network per agent",
    "cederle": "settings of Cederle 2023: one junction, images",
}


def dqn_presets(algorithm: Algorithm) -> dict[str, DQNConfig]:
    """Presets of an algorithm."""
    return {
        name: dataclasses.replace(config, algorithm=algorithm)
        for name, config in _PRESETS.items()
    }
