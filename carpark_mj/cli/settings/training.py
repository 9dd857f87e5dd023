"""Settings of runs that every trainer has, and those that `train --help` lists."""

import dataclasses
import re
from typing import Annotated

from carpark_mj.cli.process import MAX_EPISODES, MAX_SECONDS
from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    NonNegative,
    Positive,
    Seed,
)


@dataclasses.dataclass(frozen=True)
class RunConfig(CheckedConfig):
    """Settings of every trainer.

    Attributes:
        preset: settings the other flags start from.
        name: folder under `runs_dir`; empty = named by preset and seed.
        runs_dir: folder of all runs.
        resume: folder of a run to continue with its own settings.
        time_limit: time after which to save a checkpoint and stop [min]; 0 = no limit.
        seed: random seed.
        checkpoint_minutes: time between checkpoints [min].
        logger: where metrics, settings and the video go besides the folder:
            tensorboard, wandb, mlflow or a registered one; several with commas.
    """

    preset: str = ""
    name: str = ""
    runs_dir: str = "runs"
    resume: str = ""
    time_limit: NonNegative = 0.0
    seed: Seed = 0
    checkpoint_minutes: Positive = 1.0
    logger: str = "tensorboard"

    def __post_init__(self) -> None:
        super().__post_init__()
        bare = re.fullmatch(r"[^/\\]*[^/\\.\s][^/\\]*", self.name)
        if self.name and not (bare and self.name.isprintable()):
            raise ValueError(
                f"name must be the name of one folder in runs_dir, not {self.name!r}"
            )
        if not self.runs_dir.strip():
            raise ValueError(f"runs_dir must name a folder, not {self.runs_dir!r}")

    @property
    def default_name(self) -> str:
        """Name of the folder of an unnamed run."""
        return f"{self.preset}-{self.seed}"


@dataclasses.dataclass(frozen=True)
class TrainConfig(RunConfig):
    """Trains one shared parking policy for all agents with PPO (IPPO).

        carpark_mj train                        # preset by hardware, runs/cpu-0, gpu-0
        carpark_mj train --resume runs/cpu-0    # continues where it stopped
        carpark_mj train --preset dynamic --seeds 0..7       # runs side by side
        carpark_mj train --help-all --preset square          # all settings of a preset
        carpark_mj list presets                 # what --preset takes
        carpark_mj train --config mine.yaml     # a file, or the config.json of a run
        carpark_mj train --coordinator HOST:PORT --num-hosts 2 --host 0  # and --host 1
        srun carpark_mj train --coordinator auto                         # a cluster

    Ctrl-C finishes the update, saves a checkpoint and stops; a second one stops now.
    Every preset has defaults of its own.

    Attributes:
        preset: settings to start from; `auto` is `gpu` where JAX finds one, else `cpu`.
        num_steps: total number of agent steps, see `PPOConfig.steps_per_update`.
        minutes: limit of the training time, from the end of the first update, which
            compiles [min]; 0 = none. Schedules follow the share of steps or time,
            whichever is larger.
        num_lots: number of lots simulated in parallel.
        callbacks: registered callbacks (`carpark_mj.training.loggers.CALLBACKS`), which
            may change settings and end the training; several with commas.
        eval_episodes: episodes of the evaluation at the end; 0 = none.
        video_seconds: length of the video at the end [s]; 0 = none.
    """

    preset: str = "auto"
    num_steps: int = 40_000_000
    minutes: NonNegative = 0.0
    num_lots: Count = 64
    callbacks: str = ""
    eval_episodes: Annotated[int, Bounds(ge=0, le=MAX_EPISODES)] = 1024
    video_seconds: Annotated[float, Bounds(ge=0.0, le=MAX_SECONDS)] = 20.0
