"""Deep Q-learning runs from start to end."""

from pathlib import Path

import jax

from learners.dqn.config import DQNConfig
from learners.dqn.learner import DQNLearner
from learners.dqn.train import train
from learners.memory import num_bytes, require_memory
from learners.run_folder import open_run


def train_run(config: DQNConfig) -> tuple[Path, bool]:
    """Trains a run; its folder, and whether it came to its end.

    Raises:
        ValueError: impossible settings, or more than fits into memory.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    learner = DQNLearner(config)
    require_memory(num_bytes(jax.eval_shape(learner.init)), "buffer_size")
    with open_run(config) as folder:
        return folder, train(config, learner, folder)
