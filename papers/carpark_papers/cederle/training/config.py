"""Settings of every trainer of the junction."""

import dataclasses
from typing import Annotated, Literal

import jax

from carpark_mj.cli.process import MAX_EPISODES
from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.config.checks import Bounds, Count, Natural
from carpark_mj.evaluation.keys import evaluation_key
from carpark_papers.cederle.junction import JunctionConfig, RasterConfig, RewardRules
from carpark_papers.cederle.junction.config import (
    ActionKind,
    CarModel,
    Encoding,
    EndRule,
    EventRule,
)

JunctionPreset = Literal["parallel", "cederle"]
Algorithm = Literal[
    "idqn",
    "double",
    "dueling",
    "double-dueling",
    "ippo",
    "mappo",
    "maddpg",
    "vdn",
    "qmix",
]
ScenarioName = Literal["2av", "2av-hd", "3av", "3av-hd"]

VECTOR_SCALE = 20.0  # m; divides vectors, whose largest numbers are distances


@dataclasses.dataclass(frozen=True)
class JunctionRunConfig(RunConfig):
    """Settings of every trainer of the junction.

    The settings of `RunConfig` come first. Steps are control steps of junctions, of all
    of them together.

    Attributes:
        preset: settings that give the defaults of the other flags.
        algorithm: independent Q-learning is `idqn`, `double` (the online network
            chooses the action, the target network gives its value), `dueling` (a value
            and advantages make the Q-values) or `double-dueling`. The others are
            BenchMARL's.
        scenario: missions and human-driven car.
        cars: `path`, `bicycle` or `mjx`.
        observation: `vector`; independent Q-learning also takes the `image`.
        pixels: width and height of the image.
        action: `index` of one of four actions, or a `scalar`.
        shared: one network for all agents instead of one for each.
        events: `added` to the reward for the distance, or `replaced`: instead of it.
        end: an episode ends when `any` agent is done, or when `all` are.
        max_steps: control steps of an episode.
        probe: episodes begin after one joint `slow_down`.
        jitter: starts vary by up to this distance in training [m].
        num_junctions: number of junctions simulated at once.
        total_steps: steps of the training.
        eval_period: steps between evaluations.
        eval_episodes: episodes of each evaluation, with greedy actions.
        eval_jitter: starts vary by up to this distance in evaluations [m].
        video_episodes: episodes of the last policy in `video.mp4`; 0 = no video.
    """

    preset: JunctionPreset = "parallel"
    algorithm: Algorithm = "double-dueling"
    scenario: ScenarioName = "2av"
    cars: CarModel = "path"
    observation: Encoding = "vector"
    pixels: int = 84
    action: ActionKind = "index"
    shared: bool = False
    events: EventRule = "added"
    end: EndRule = "any"
    max_steps: int = 75
    probe: bool = False
    jitter: float = 1.0
    num_junctions: Count = 64
    total_steps: Count = 1_000_000
    eval_period: Count = 20_000
    eval_episodes: Annotated[int, Bounds(ge=1, le=MAX_EPISODES)] = 64
    eval_jitter: float = 1.0
    video_episodes: Natural = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        dataclasses.replace(self.junction, jitter=self.eval_jitter)  # refuses too much

    def require_action(self, *kinds: ActionKind) -> None:
        """Refuses kinds of actions that the algorithm does not support."""
        if self.action not in kinds:
            raise ValueError(
                f"{self.algorithm} chooses actions by {' or '.join(kinds)}, not by "
                f"{self.action}: give --action {kinds[0]}"
            )

    def evaluation_keys(self) -> jax.Array:
        """Keys of the episodes of an evaluation.

        They are fixed, so that the curve shows the policy only.
        """
        return jax.random.split(evaluation_key(self.seed), self.eval_episodes)

    @property
    def default_name(self) -> str:
        """Default name of the run's folder."""
        return f"{self.algorithm}-{self.scenario}-{self.seed}"

    @property
    def junction(self) -> JunctionConfig:
        """The environment of the training."""
        return JunctionConfig(
            scenario=self.scenario,
            cars=self.cars,
            observation=self.observation,
            raster=RasterConfig(pixels=self.pixels),
            action=self.action,
            rewards=RewardRules(events=self.events),
            end=self.end,
            max_steps=self.max_steps,
            probe=self.probe,
            jitter=self.jitter,
        )
