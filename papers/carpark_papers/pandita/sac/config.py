"""Phases, settings and presets of SAC training."""

import dataclasses
import re
from typing import Literal

from carpark_mj.cli.common import MAX_EPISODES, MAX_SECONDS
from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.config.checks import (
    require_at_least,
    require_choice,
    require_finite,
    require_positive,
    require_ratio,
    require_whole,
)
from carpark_mj.layouts import MixtureConfig, layout_config
from carpark_mj.registry import environment
from carpark_mj.training.run_folder import RunConfig
from carpark_papers.pandita.layouts import SlotsConfig
from carpark_papers.pandita.slots_env import slots_config

_TEXT = re.compile(r"(?P<kinds>[^:]+):(?P<count>-?\d+)(?P<unit>steps|episodes)?")


@dataclasses.dataclass(frozen=True)
class Phase:
    """A stretch of training on one kind of lot, or on several interleaved.

    Exactly one of `steps` and `episodes` is given.
    """

    kinds: tuple[str, ...]  # names of layouts; every episode draws one of them
    steps: int = 0  # transitions of all cars together
    episodes: int = 0  # that end, of all cars together

    def __post_init__(self) -> None:
        if min(self.steps, self.episodes) < 0 or bool(self.steps) == bool(
            self.episodes
        ):
            raise ValueError(
                f"a phase needs steps or episodes, at least 1, not {self.steps} steps "
                f"and {self.episodes} episodes"
            )
        for kind in self.kinds:
            layout_config(kind)

    def __str__(self) -> str:
        return ", ".join(self.kinds)

    def progress(self, steps: int, episodes: int) -> float:
        """Share of the phase, in [0, 1], after some steps and episodes of it."""
        return min(1.0, steps / self.steps if self.steps else episodes / self.episodes)


def read_phase(text: str) -> Phase:
    """Reads `KINDS:COUNT`, `KINDS:COUNTsteps` or `KINDS:COUNTepisodes`.

    Args:
        text: kinds are separated by commas: `slots,slots_diagonal:250episodes`.
    """
    found = _TEXT.fullmatch(text)
    if not found:
        raise ValueError(
            "a phase is KINDS:STEPS or KINDS:COUNTepisodes, for example "
            f"slots,slots_diagonal:30000, not {text!r}"
        )
    kinds = tuple(kind.strip() for kind in found["kinds"].split(","))
    count = int(found["count"])
    try:
        return Phase(kinds, **{found["unit"] or "steps": count})
    except ValueError as error:
        raise ValueError(f"phase {text!r}: {error}") from None


def mixture(layouts: list[LayoutConfig], weights: list[float]) -> LayoutConfig:
    """One lot, or a random one of several."""
    if len(layouts) == 1:
        return layouts[0]
    return MixtureConfig(tuple(layouts), tuple(weights))


SACPreset = Literal["slots", "study", "pandita"]
Replay = Literal["her", "plain", "none"]
Environment = Literal["pandita", "slots"]
AtSwitch = Literal["keep", "clear", "balance"]

# What the short help lists.
RUN_SETTINGS = (
    "preset",
    "name",
    "runs_dir",
    "resume",
    "time_limit",
    "seed",
    "phases",
    "replay",
    "environment",
    "num_cars",
    "rehearsal",
    "eval_episodes",
    "video_seconds",
)


@dataclasses.dataclass(frozen=True)
class SACConfig(RunConfig):
    """Settings of `carpark_mj study sac`; every field is a flag.

    The settings of `RunConfig` come first.

    Attributes:
        preset: settings that give the defaults of the other flags.
        checkpoint_minutes: time between checkpoints, which include the buffer [min].
        phases: phases in order, `KINDS:STEPS` or `KINDS:COUNTepisodes`: names of
            layouts, with commas if they are interleaved, and the length.
        deploy: kinds of lots on which the policy is deployed after every phase.
        goal_slot: number of the goal's slot; `random` = any, `own` = that of the kind.
        half_corridor: `SlotsConfig.half_corridor` of all kinds [m].
        environment: `pandita`, highway-env's car, or `slots`, a rigid-body car.
        replay: `her`, `plain`, or `none`: a buffer of the latest transitions only.
        hindsight_goals: relabelled transitions for each real one.
        rehearsal: share of the episodes on kinds of earlier phases.
        at_switch: the buffer at the beginning of a phase: `keep`, `clear`, or
            `balance`: kept, with equal shares of all phases in a sample.
        num_cars: number of cars simulated at once.
        gradient_steps: gradient steps after each step of all cars.
        batch_size: transitions of a gradient step.
        buffer_size: size of the buffer [transitions].
        random_steps: random steps of every car before the policy acts and learns.
        learning_rate: Adam's learning rate at the beginning of every phase.
        learning_rate_end: that at the end of the phase; linear in between.
        discount: discount factor per control step.
        tau: share of the networks in the update of their targets.
        target_entropy: target entropy of the policy [nat].
        hidden: widths of the hidden layers of actor and critics.
        eval_episodes: episodes on every kind of `deploy` after every phase.
        video_seconds: length of the video at the end, 0 = none.
    """

    preset: SACPreset = "slots"
    checkpoint_minutes: float = 5.0
    phases: tuple[str, ...] = ("slots:200000",)
    deploy: tuple[str, ...] = ("slots", "slots_diagonal", "slots_parallel")
    goal_slot: int | Literal["random", "own"] = "own"
    half_corridor: float = 10.0
    environment: Environment = "pandita"
    replay: Replay = "her"
    hindsight_goals: int = 4
    rehearsal: float = 0.0
    at_switch: AtSwitch = "keep"
    num_cars: int = 32
    gradient_steps: int = 8
    batch_size: int = 256
    buffer_size: int = 300_000
    random_steps: int = 151
    learning_rate: float = 1e-3
    learning_rate_end: float = 2e-5
    discount: float = 0.95
    tau: float = 0.02
    target_entropy: float = -2.0
    hidden: tuple[int, ...] = (128, 128)
    eval_episodes: int = 30
    video_seconds: float = 20.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("environment", self.environment, Environment)
        require_choice("replay", self.replay, Replay)
        require_choice("at_switch", self.at_switch, AtSwitch)
        if self.at_switch == "balance" and self.replay != "her":
            raise ValueError(f"at_switch balance needs replay her, not {self.replay}")
        require_whole(
            self, 1, "num_cars", "gradient_steps", "batch_size", "hindsight_goals"
        )
        require_whole(self, 1, "eval_episodes", "random_steps")
        require_whole(self, self.num_cars, "buffer_size")
        require_positive(
            self, "learning_rate", "learning_rate_end", "tau", "half_corridor"
        )
        require_ratio(self, "discount", "tau", "rehearsal")
        require_at_least(self, 0, "video_seconds")
        require_finite(self, "target_entropy")
        if self.eval_episodes > MAX_EPISODES or self.video_seconds > MAX_SECONDS:
            raise ValueError(
                f"eval_episodes must be at most {MAX_EPISODES} and video_seconds at "
                f"most {MAX_SECONDS}, not {self.eval_episodes} and {self.video_seconds}"
            )
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(
                f"hidden must be one width or more, each at least 1, not {self.hidden}"
            )
        if not self.phases or not self.deploy:
            raise ValueError("phases and deploy must name one kind of lot or more")
        for kind in self.kinds:
            self.layout(kind)

    @property
    def schedule(self) -> tuple[Phase, ...]:
        """The phases."""
        return tuple(map(read_phase, self.phases))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of lots that are trained or deployed on, each once."""
        trained = [kind for phase in self.schedule for kind in phase.kinds]
        return tuple(dict.fromkeys((*self.deploy, *trained)))

    def layout(self, kind: str) -> LayoutConfig:
        """The lot of a kind."""
        config = layout_config(kind)
        if not isinstance(config, SlotsConfig):
            raise ValueError(
                f"{kind!r} is not a kind of slots; choose from slots, slots_diagonal, "
                "slots_parallel, slots_single and slots_single_diagonal"
            )
        config = dataclasses.replace(config, half_corridor=self.half_corridor)
        if self.goal_slot == "own":
            return config
        slot = None if self.goal_slot == "random" else self.goal_slot
        return dataclasses.replace(config, goal_slot=slot)

    def layout_of_phase(self, number: int) -> LayoutConfig:
        """The lots of a phase, among them those of earlier ones for rehearsal."""
        phases = self.schedule
        now = phases[number].kinds
        before = {kind for phase in phases[:number] for kind in phase.kinds}
        old = sorted(before - {*now}) if self.rehearsal else []
        share = self.rehearsal if old else 0.0
        kinds = [(kind, (1.0 - share) / len(now)) for kind in now]
        kinds += [(kind, share / len(old)) for kind in old]
        kinds = [(kind, weight) for kind, weight in kinds if weight]
        layouts = [self.layout(kind) for kind, _ in kinds]
        return mixture(layouts, [weight for _, weight in kinds])

    @property
    def env(self) -> EnvConfig:
        """The environment at the beginning, as the help describes it."""
        first = ",".join(self.schedule[0].kinds)
        return dataclasses.replace(environment(self.environment), layout=first)

    def env_of(self, layout: LayoutConfig) -> EnvConfig:
        """The environment of some lots; every slot but the goal's is taken."""
        return slots_config({"config": environment(self.environment), "layout": layout})


SAC_PRESETS: dict[str, SACConfig] = {
    "slots": SACConfig(),
    # The budgets of Pandita 2022 with smaller networks and batches than his, but twice
    # as many gradient steps, and falling learning rates: at a constant rate the
    # deterministic policy parks or crashes from one update to the next.
    "study": SACConfig(
        preset="study",
        phases=("slots:15000",),
        num_cars=4,
        gradient_steps=8,
        learning_rate_end=1e-4,
    ),
    # His hyperparameters; highway-env's example has the same. Of those that he leaves
    # at the defaults of Stable-Baselines3: 100 random steps, one gradient step.
    "pandita": SACConfig(
        preset="pandita",
        phases=("slots:15000",),
        num_cars=1,
        gradient_steps=1,
        batch_size=1024,
        buffer_size=1_000_000,
        random_steps=100,
        learning_rate_end=1e-3,
        tau=0.05,
        hidden=(512, 512, 512),
    ),
}

SAC_SUMMARIES = {
    "slots": "vertical slots, many cars at once",
    "study": "budgets of Pandita 2022, small networks",
    "pandita": "settings of Pandita 2022, hours on a CPU",
}
