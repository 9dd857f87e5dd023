"""Phases, settings and presets of SAC training."""

import dataclasses
import re
from typing import Annotated, Literal

from carpark_mj.cli.process import MAX_EPISODES, MAX_SECONDS
from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.config.checks import (
    Bounds,
    Count,
    Finite,
    Positive,
    Ratio,
    require_count,
)
from carpark_mj.layouts import MixtureConfig, layout_config
from carpark_mj.registry import environment
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
        goal_slot: number of the goal's slot; `random` = any, `own` = the kind's.
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
        learning_rate_end: learning rate at the end of the phase; linear in between.
        discount: discount factor per control step.
        tau: share of the networks in the update of their targets.
        target_entropy: target entropy of the policy [nat].
        hidden: widths of the hidden layers of actor and critics.
        eval_episodes: episodes on every kind of `deploy` after every phase.
        video_seconds: length of the video at the end, 0 = none.
    """

    preset: SACPreset = "slots"
    checkpoint_minutes: Positive = 5.0
    phases: tuple[str, ...] = ("slots:200000",)
    deploy: tuple[str, ...] = ("slots", "slots_diagonal", "slots_parallel")
    goal_slot: int | Literal["random", "own"] = "own"
    half_corridor: Positive = 10.0
    environment: Environment = "pandita"
    replay: Replay = "her"
    hindsight_goals: Count = 4
    rehearsal: Ratio = 0.0
    at_switch: AtSwitch = "keep"
    num_cars: Count = 32
    gradient_steps: Count = 8
    batch_size: Count = 256
    buffer_size: int = 300_000
    random_steps: Count = 151
    learning_rate: Positive = 1e-3
    learning_rate_end: Positive = 2e-5
    discount: Ratio = 0.95
    tau: Annotated[float, Bounds(gt=0.0, le=1.0)] = 0.02
    target_entropy: Finite = -2.0
    hidden: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)
    eval_episodes: Annotated[int, Bounds(ge=1, le=MAX_EPISODES)] = 30
    video_seconds: Annotated[float, Bounds(ge=0.0, le=MAX_SECONDS)] = 20.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.at_switch == "balance" and self.replay != "her":
            raise ValueError(f"at_switch balance needs replay her, not {self.replay}")
        require_count("buffer_size", self.buffer_size, self.num_cars)
        if not (self.phases and self.deploy and self.hidden):
            raise ValueError("phases, deploy and hidden must have one item or more")
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
        """The lots of a phase, with lots of earlier phases for rehearsal."""
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
    # The thesis's hyperparameters, as in highway-env's example. Defaults of
    # Stable-Baselines3: 100 random steps, one gradient step.
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
