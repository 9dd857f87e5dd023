"""Settings of deep Q-learning at the junction."""

import dataclasses
import math
from typing import Literal

from carpark_mj.cli.common import MAX_EPISODES
from carpark_mj.config.checks import choose, positive, ratio, whole
from carpark_mj.junction import JunctionConfig, RewardRules
from carpark_mj.junction.config import CarModel, Encoding, EndRule, EventRule
from learners.run_folder import RunConfig

DQNPreset = Literal["parallel", "cederle"]
Algorithm = Literal["dqn", "double-dqn", "dueling-dqn", "dueling-double-dqn"]
ScenarioName = Literal["2av", "2av-hd", "3av", "3av-hd"]
Optimizer = Literal["adam", "rmsprop"]

CHUNK = 100  # most control steps between looks at the clock

# What the short help lists.
RUN_SETTINGS = (
    "preset",
    "name",
    "runs_dir",
    "resume",
    "time_limit",
    "seed",
    "scenario",
    "algorithm",
    "cars",
    "observation",
    "shared",
    "num_junctions",
    "total_steps",
    "eval_period",
    "eval_episodes",
)


@dataclasses.dataclass(frozen=True)
class DQNConfig(RunConfig):
    """Settings of `python train/junction.py`; every field is a flag.

    The settings of `RunConfig` come first. Steps are control steps of junctions, of all
    of them together.

    Attributes:
        preset: settings the other flags start from.
        checkpoint_minutes: time between checkpoints, which hold the buffer [min].
        scenario: who drives where.
        algorithm: `double`: the online network chooses the action whose value the
            target network gives. `dueling`: a value and advantages make the Q-values.
        cars: `path`, `bicycle` or `mjx`.
        observation: `vector`, or `image` with the study's convolutional network.
        shared: one network for all agents instead of one for each.
        events: `added` to the reward for the way, or `replaced`: in its place.
        end: an episode ends when `any` agent is done, or when `all` are.
        max_steps: control steps of an episode.
        probe: episodes begin one joint `slow_down` in.
        jitter: starts vary by up to this way in training [m].
        num_junctions: simulated at once.
        total_steps: of the training.
        updates: gradient steps of every network after each step of all junctions.
        batch_size: transitions of a gradient step.
        buffer_size: transitions that a network's buffer holds.
        random_steps: before learning begins.
        optimizer: `adam` or `rmsprop`.
        learning_rate: of the optimiser.
        discount: discount factor per control step.
        target_period: gradient steps between copies to the target network.
        epsilon_end: share of random actions at the end of their decay from 1.
        epsilon_steps: length of this linear decay.
        hidden: widths of the hidden layers behind vectors.
        eval_period: steps between evaluations.
        eval_episodes: of each, with greedy actions.
        eval_jitter: starts vary by up to this way in evaluations [m].
    """

    preset: DQNPreset = "parallel"
    checkpoint_minutes: float = 5.0
    scenario: ScenarioName = "2av"
    algorithm: Algorithm = "dueling-double-dqn"
    cars: CarModel = "path"
    observation: Encoding = "vector"
    shared: bool = False
    events: EventRule = "added"
    end: EndRule = "any"
    max_steps: int = 75
    probe: bool = False
    jitter: float = 1.0
    num_junctions: int = 64
    total_steps: int = 1_000_000
    updates: int = 4
    batch_size: int = 256
    buffer_size: int = 50_000
    random_steps: int = 2_000
    optimizer: Optimizer = "adam"
    learning_rate: float = 5e-4
    discount: float = 0.99
    target_period: int = 200
    epsilon_end: float = 0.02
    epsilon_steps: int = 100_000
    hidden: tuple[int, ...] = (128, 128)
    eval_period: int = 20_000
    eval_episodes: int = 64
    eval_jitter: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        choose("algorithm", self.algorithm, Algorithm)
        choose("optimizer", self.optimizer, Optimizer)
        whole(self, 1, "num_junctions", "total_steps", "updates", "batch_size")
        whole(self, 1, "target_period", "epsilon_steps", "eval_period", "random_steps")
        whole(self, max(self.batch_size, self.added), "buffer_size")
        whole(self, 1, "eval_episodes")
        if self.eval_episodes > MAX_EPISODES:
            raise ValueError(
                f"eval_episodes must be at most {MAX_EPISODES}, not "
                f"{self.eval_episodes}"
            )
        positive(self, "learning_rate")
        ratio(self, "discount", "epsilon_end")
        dataclasses.replace(self.junction, jitter=self.eval_jitter)  # refuses too much
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(
                f"hidden must be one width or more, each at least 1, not {self.hidden}"
            )

    @property
    def double(self) -> bool:
        """Whether the online network chooses the next action."""
        return "double" in self.algorithm

    @property
    def dueling(self) -> bool:
        """Whether a value and advantages make the Q-values."""
        return "dueling" in self.algorithm

    @property
    def junction(self) -> JunctionConfig:
        """The environment of the training."""
        return JunctionConfig(
            scenario=self.scenario,
            cars=self.cars,
            observation=self.observation,
            rewards=RewardRules(events=self.events),
            end=self.end,
            max_steps=self.max_steps,
            probe=self.probe,
            jitter=self.jitter,
        )

    @property
    def networks(self) -> int:
        """How many learn."""
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
