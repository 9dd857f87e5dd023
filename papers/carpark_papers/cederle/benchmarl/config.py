"""Settings and presets of BenchMARL's algorithms."""

import dataclasses
from typing import Annotated, Any

from carpark_mj.config.checks import (
    Bounds,
    Count,
    Natural,
    NonNegative,
    Positive,
    Ratio,
    require_count,
    require_number,
)
from carpark_papers.cederle.junction.config import EndRule
from carpark_papers.cederle.training.config import Algorithm, JunctionRunConfig

ON_POLICY: tuple[Algorithm, ...] = ("ippo", "mappo")


@dataclasses.dataclass(frozen=True)
class BenchMARLConfig(JunctionRunConfig):
    """Settings of BenchMARL's algorithms; every field is a flag.

    The settings of `JunctionRunConfig` come first.

    Attributes:
        repeat: control steps for which actions are held in training.
        unroll: decisions of every agent between updates.
        updates: passes over these steps (`ippo`, `mappo`), or gradient steps on batches
            of the buffer after them.
        batch_size: transitions of a gradient step.
        buffer_size: size of the buffer [transitions]; not of `ippo`, `mappo`.
        random_steps: random steps before learning begins; not of `ippo`, `mappo`.
        learning_rate: Adam's learning rate.
        critic_learning_rate: learning rate of MADDPG's critic.
        max_gradient: norm to which gradients are clipped.
        discount: discount factor per decision, of `repeat` control steps.
        gae_lambda: trade-off of bias and variance of advantages (`ippo`, `mappo`).
        clip: range about 1 to which probability ratios are clipped (`ippo`, `mappo`).
        entropy: weight of the entropy bonus at the beginning, from which it falls
            linearly to 0 (`ippo`, `mappo`).
        tau: share of the target network that an update replaces; not of `ippo`,
            `mappo`.
        epsilon_start: share of random actions, or of MADDPG the standard deviation of
            the noise, at the beginning; not of `ippo`, `mappo`.
        epsilon_end: its value at the end of the decay.
        epsilon_steps: length of this linear decay.
        hidden: widths of the hidden layers.
        recurrent: units of a recurrent layer behind them; 0 = none.
    """

    algorithm: Algorithm = "mappo"
    shared: bool = True
    end: EndRule = "all"
    checkpoint_minutes: Positive = 5.0
    repeat: Count = 1
    unroll: Count = 32
    updates: Count = 4
    batch_size: Count = 1024
    buffer_size: int = 100_000
    random_steps: Natural = 2_000
    learning_rate: Positive = 1e-3
    critic_learning_rate: Positive = 1e-3
    max_gradient: Positive = 10.0
    discount: Ratio = 0.99
    gae_lambda: Ratio = 0.95
    clip: Positive = 0.2
    entropy: NonNegative = 0.01
    tau: Ratio = 0.01
    epsilon_start: NonNegative = 1.0
    epsilon_end: Ratio = 0.05
    epsilon_steps: Count = 200_000
    hidden: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)
    recurrent: Natural = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.preset == "cederle" and self.on_policy:
            raise ValueError(
                f"the study does not have {self.algorithm}: choose --preset parallel, "
                "or another algorithm"
            )
        if self.algorithm == "maddpg":
            self.require_action("scalar")
        elif self.on_policy:
            self.require_action("index", "scalar")
        else:
            self.require_action("index")
        if self.observation != "vector":
            raise ValueError(
                f"{self.algorithm} observes vectors here, not {self.observation}: give "
                "--observation vector"
            )
        if self.max_steps % self.repeat:
            raise ValueError(
                f"max_steps must be a multiple of repeat, {self.repeat}, or time would "
                f"run out within a decision, not {self.max_steps}"
            )
        require_count("buffer_size", self.buffer_size, self.batch_size)
        if self.on_policy and self.batch_size > self.decisions:
            raise ValueError(
                f"batch_size must be at most {self.decisions}, num_junctions times "
                f"unroll, not {self.batch_size}"
            )
        if not self.on_policy and self.epsilon_start < self.epsilon_end:
            raise ValueError(
                f"epsilon_start must be at least epsilon_end, {self.epsilon_end}, not "
                f"{self.epsilon_start}"
            )
        if self.algorithm in ("vdn", "qmix"):
            require_number("epsilon_start", self.epsilon_start, Bounds(ge=0.0, le=1.0))
        if not self.hidden:
            raise ValueError("hidden must have one width or more")

    @property
    def on_policy(self) -> bool:
        """Whether it learns from its own last steps only."""
        return self.algorithm in ON_POLICY

    @property
    def decisions(self) -> int:
        """Decisions of an agent between updates, in all junctions together."""
        return self.num_junctions * self.unroll

    @property
    def frames(self) -> int:
        """Control steps between updates, of all junctions together."""
        return self.decisions * self.repeat

    @property
    def iterations(self) -> int:
        """How many times the junctions are unrolled."""
        return -(-self.total_steps // self.frames)

    @property
    def iterations_per_evaluation(self) -> int:
        """How many unrolls lie between two evaluations."""
        return -(-self.eval_period // self.frames)


# Starts vary more than in evaluations, and an agent that waits has the time to get
# through. Random actions held for 0.5 s brake for long enough to discover waiting.
PPO: dict[str, Any] = {
    "max_steps": 150,
    "jitter": 3.0,
    "repeat": 5,
    "num_junctions": 256,
    "discount": 0.995,
}
# An update every few steps, as many transitions of the buffer as there are new ones.
OFF_POLICY: dict[str, Any] = {
    "end": "any",
    "num_junctions": 64,
    "unroll": 8,
    "updates": 8,
    "batch_size": 256,
    "learning_rate": 5e-4,
    "total_steps": 500_000,
}
MADDPG: dict[str, Any] = {"action": "scalar", "shared": False}

# Cederle 2023, section 5.3 and table 5.2, and, where the text is silent, its program.
# Evaluations vary the starts, or all of their episodes would be equal.
STUDY: dict[str, Any] = {
    "preset": "cederle",
    "end": "any",
    "jitter": 0.0,
    "num_junctions": 1,
    "updates": 1,
    "random_steps": 0,
    "total_steps": 500_000,
    "eval_period": 5000,
    "eval_episodes": 20,
}
STUDY_MADDPG: dict[str, Any] = {
    "unroll": 100,
    "batch_size": 1024,
    "buffer_size": 1_000_000,
    "learning_rate": 1e-4,
    "critic_learning_rate": 1e-3,
    "discount": 0.95,
    "tau": 0.01,
    "epsilon_end": 1.0,
    "hidden": (64, 64),
}
# As its program: whole episodes are learnt from, once per episode.
STUDY_MIXING: dict[str, Any] = {
    "unroll": 75,
    "batch_size": 32 * 75,
    "buffer_size": 5000 * 75,
    "learning_rate": 5e-4,
    "tau": 0.005,
    "epsilon_steps": 50_000,
    "hidden": (64,),
    "recurrent": 64,
}

BENCHMARL_SUMMARIES = {
    "parallel": "many junctions at once, small networks",
    "cederle": "settings of Cederle 2023: one junction (not of ippo, mappo)",
}


def benchmarl_presets(algorithm: Algorithm) -> dict[str, BenchMARLConfig]:
    """Presets of an algorithm."""
    if algorithm in ON_POLICY:
        return {"parallel": BenchMARLConfig(algorithm=algorithm, **PPO)}
    own = MADDPG if algorithm == "maddpg" else {}
    study = STUDY_MADDPG if algorithm == "maddpg" else STUDY_MIXING
    base = BenchMARLConfig(algorithm=algorithm, **(OFF_POLICY | own))
    return {"parallel": base, "cederle": dataclasses.replace(base, **(STUDY | study))}
