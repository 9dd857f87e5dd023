"""Warm starts: a training that begins with the networks of another run."""

import dataclasses
from pathlib import Path

from carpark_mj.policy import checkpoints
from carpark_mj.policy.loading import load_policy
from learners.ppo.config import PPOConfig
from learners.ppo.state import TrainingState

# What a run takes over; optimizer, schedules, lots and counters are its own.
TAKEN = ("normalizer", "policy", "average", "value")


def require_run(config: PPOConfig) -> None:
    """Refuses a warm start from what is no run.

    Raises:
        ValueError: there is nothing of that name. Pretrained policies are found by
            name elsewhere, but have no critic.
    """
    if config.warm_start and not Path(config.warm_start).exists():
        raise ValueError(
            "warm_start must be the folder or a checkpoint of a run, not "
            f"{config.warm_start!r}"
        )


def warm_start(config: PPOConfig, state: TrainingState) -> TrainingState:
    """A state before the first update, with networks of the run `warm_start`.

    Args:
        config: of the training.
        state: as it would begin otherwise.

    Raises:
        CheckpointError: the run has no checkpoint, or other networks.
        ValueError: its agents observe or do something else.
    """
    path = load_policy(Path(config.warm_start), env=config.env).path
    template = {name: getattr(state, name) for name in TAKEN}
    return dataclasses.replace(state, **checkpoints.load(path, template))
