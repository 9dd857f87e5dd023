"""Settings and presets of independent deep Q-learning."""

import dataclasses
import math
from typing import Annotated, Literal

from carpark_mj.config.checks import Bounds, Count, Positive, Ratio, require_count
from carpark_papers.cederle.training.config import Algorithm, JunctionRunConfig

Optimizer = Literal["adam", "rmsprop"]

CHUNK = 100  # most control steps between looks at the clock
MIN_PIXELS = 36  # of a side, below which the convolutions leave nothing


@dataclasses.dataclass(frozen=True)
class DQNConfig(JunctionRunConfig):
    """Settings of independent deep Q-learning; every field is a flag.

    The settings of `JunctionRunConfig` come first.

    Attributes:
        checkpoint_minutes: time between checkpoints, which include the buffer [min].
        updates: gradient steps of every network after each step of all junctions.
        batch_size: transitions of a gradient step.
        buffer_size: size of a network's buffer [transitions].
        random_steps: random steps before learning begins.
        optimizer: `adam` or `rmsprop`.
        learning_rate: learning rate of the optimiser.
        discount: discount factor per control step.
        target_period: gradient steps between copies to the target network.
        epsilon_end: share of random actions at the end of their decay from 1.
        epsilon_steps: length of this linear decay.
        hidden: widths of the hidden layers behind vectors.
    """

    checkpoint_minutes: Positive = 5.0
    num_junctions: Count = 32
    total_steps: Count = 500_000
    updates: Count = 8
    batch_size: Count = 128
    buffer_size: int = 50_000
    random_steps: Count = 2_000
    optimizer: Optimizer = "adam"
    learning_rate: Positive = 5e-4
    discount: Ratio = 0.99
    target_period: Count = 200
    epsilon_end: Ratio = 0.05
    epsilon_steps: Count = 300_000
    hidden: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_action("index")
        if self.observation == "image" and self.pixels < MIN_PIXELS:
            raise ValueError(
                f"pixels must be at least {MIN_PIXELS} for the convolutional network, "
                f"not {self.pixels}"
            )
        least = max(self.batch_size, self.added)
        require_count("buffer_size", self.buffer_size, least)
        if not self.hidden:
            raise ValueError("hidden must have one width or more")

    @property
    def double(self) -> bool:
        """Whether the online network chooses the next action."""
        return "double" in self.algorithm

    @property
    def dueling(self) -> bool:
        """Whether a value and advantages make the Q-values."""
        return "dueling" in self.algorithm

    @property
    def networks(self) -> int:
        """Number of networks that learn."""
        return 1 if self.shared else len(self.junction.traffic.missions)

    @property
    def added(self) -> int:
        """Transitions that a network's buffer gets from a step of all junctions."""
        agents = len(self.junction.traffic.missions)
        return self.num_junctions * agents // self.networks

    @property
    def chunk(self) -> int:
        """Control steps of a junction between looks at the clock."""
        return min(CHUNK, math.ceil(self.eval_period / self.num_junctions))

    @property
    def chunks_per_evaluation(self) -> int:
        """How many chunks lie between two evaluations."""
        return math.ceil(self.eval_period / (self.num_junctions * self.chunk))


_PRESETS: dict[str, DQNConfig] = {
    "parallel": DQNConfig(),
    # Cederle 2023, section 5.3 and, where the text is silent, its program. Evaluations
    # vary the starts, or all of their episodes would be equal.
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
