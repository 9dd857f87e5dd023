"""Deep Q-learning runs from start to end."""

from pathlib import Path

import jax

from carpark_mj.training.memory import num_bytes, require_memory
from carpark_mj.training.run_folder import open_run
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.dqn.learner import DQNLearner
from carpark_papers.cederle.dqn.train import train


def train_run(config: DQNConfig) -> tuple[Path, bool]:
    """Trains a run; returns its folder and whether it is finished.

    Raises:
        ValueError: impossible settings, or more than fits into memory.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    learner = DQNLearner(config)
    require_memory(num_bytes(jax.eval_shape(learner.init)), "buffer_size")
    with open_run(config) as folder:
        return folder, train(config, learner, folder)
