"""Settings of PPO training: one frozen dataclass, and presets.

`cpu`, `gpu` and their mixtures are made for a kind of hardware. The others are the
experiments of Tanner 2022 by the names of their environments, `carpark_mj.registry`:
16 M agent steps with settings of our own, meant for a GPU.

`tanner-fixed-original` has the study's hyperparameters, table 5.1, so far as this loop
has them, for 12.8 M steps: in his last 3.2 M of 16 M he learns nothing. It differs:

- data: 126 agents of 18 lots times 32 steps for an update (4032 of his 4096), of whom
  he has the 7 of one lot and cuts their ways after 128 steps.
- a minibatch of 32 is one agent's 32 steps in a row, not 32 steps from anywhere, and
  its advantages are normalised by themselves, not with all of the update's.
- the ratio clipped is that of the whole action, not each branch's; the value's change
  is not clipped, and weighs half as much beside the policy's loss.
- observations are normalised, and weights start as Brax starts them (LeCun).
"""

import dataclasses
import math
from typing import Literal

from carpark_mj.config import EnvConfig, RewardConfig, SpawnConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.registry import DYNAMIC, FIXED, TANNER_DYNAMIC, TANNER_FIXED

PresetName = Literal[
    "auto",
    "cpu",
    "gpu",
    "cpu-mixture",
    "gpu-mixture",
    "fixed",
    "dynamic",
    "tanner-fixed",
    "tanner-fixed-original",
    "tanner-dynamic",
]


@dataclasses.dataclass(frozen=True)
class PPOConfig:
    """Settings of `python train/ppo.py`; every field is a flag.

    Attributes:
        preset: settings the other flags start from; `auto` asks JAX for a GPU.
        name: folder under `runs_dir`; empty = preset and seed.
        runs_dir: where runs are kept.
        resume: folder of a run to continue; its own settings hold.
        time_limit: stop with a checkpoint after so many minutes; 0 = no limit.
        seed: of everything.
        num_steps: agent steps in all.
        num_lots: lots simulated at once.
        lot_life: updates, at most, until a random lot gives way to another, a few lots
            after every update; 0 = never. A lot that no key changes stays.
        unroll_length: control steps between updates.
        num_minibatches: per epoch.
        num_epochs: passes over the data of an update.
        learning_rate: of Adam at the start.
        learning_rate_end: at the end; linear in between.
        entropy_cost: weight of the entropy bonus at the start.
        entropy_cost_end: at the end.
        clip: PPO's clipping of the probability ratio at the start.
        clip_end: at the end.
        discount: per control step.
        gae_lambda: of generalised advantage estimation.
        max_grad_norm: gradient clipping.
        averaged_updates: the policy that is evaluated is the exponential mean over
            about so many updates; 1 = the last one.
        hitbox_scale: what cars' lengths and widths count times when it comes to
            crashes, at first: a margin to learn. Evaluations never scale.
        hitbox_steps: agent steps until it is 1, in whole updates.
        checkpoint_minutes: time between checkpoints.
        checkpoint_updates: if positive, updates between checkpoints instead.
        eval_episodes: episodes of the evaluation at the end; 0 = none.
        video_seconds: length of the video at the end [s]; 0 = none.
        networks: sizes of actor and critic.
        env: the environment.
    """

    preset: PresetName = "auto"
    name: str = ""
    runs_dir: str = "runs"
    resume: str = ""
    time_limit: float = 0.0
    seed: int = 0
    num_steps: int = 10_000_000
    num_lots: int = 64
    lot_life: int = 16
    unroll_length: int = 64
    num_minibatches: int = 16
    num_epochs: int = 4
    learning_rate: float = 1.5e-3
    learning_rate_end: float = 2e-4
    entropy_cost: float = 5e-3
    entropy_cost_end: float = 1e-3
    clip: float = 0.2
    clip_end: float = 0.2
    discount: float = 0.99
    gae_lambda: float = 0.92
    max_grad_norm: float = 1.0
    averaged_updates: int = 32
    hitbox_scale: float = 1.0
    hitbox_steps: int = 0
    checkpoint_minutes: float = 1.0
    checkpoint_updates: int = 0
    eval_episodes: int = 1024
    video_seconds: float = 20.0
    networks: NetworkConfig = NetworkConfig()
    env: EnvConfig = EnvConfig()

    def __post_init__(self) -> None:
        for name in (
            "num_steps",
            "num_lots",
            "unroll_length",
            "num_minibatches",
            "num_epochs",
            "averaged_updates",
        ):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        for name in ("learning_rate", "max_grad_norm", "clip", "checkpoint_minutes"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        for name in ("discount", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(
                    f"{name} must lie in [0, 1], not {getattr(self, name)}"
                )
        for name in (
            "lot_life",
            "learning_rate_end",
            "entropy_cost",
            "entropy_cost_end",
            "clip_end",
            "time_limit",
            "eval_episodes",
            "video_seconds",
            "checkpoint_updates",
            "hitbox_steps",
        ):
            if getattr(self, name) < 0:
                raise ValueError(
                    f"{name} must not be negative, not {getattr(self, name)}"
                )
        if not 0.0 < self.hitbox_scale < math.inf:
            raise ValueError(f"hitbox_scale must be positive, not {self.hitbox_scale}")
        if self.hitbox_scale != 1.0 and not self.hitbox_steps:
            raise ValueError(
                f"hitbox_scale {self.hitbox_scale} needs hitbox_steps of at least 1, "
                "not 0"
            )
        if self.hitbox_scale != 1.0 and self.env.physics == "scene":
            raise ValueError(
                f"hitbox_scale must be 1 in scene physics, where crashes are contacts, "
                f"not {self.hitbox_scale}"
            )
        agents = self.num_lots * self.env.num_agents
        if agents % self.num_minibatches:
            raise ValueError(
                f"num_lots x num_agents = {agents} must be a multiple of "
                f"num_minibatches {self.num_minibatches}"
            )

    @property
    def steps_per_update(self) -> int:
        """Agent steps collected for one update."""
        return self.num_lots * self.env.num_agents * self.unroll_length

    @property
    def hitbox_updates(self) -> int:
        """Updates with scaled hitboxes."""
        return -(-self.hitbox_steps // self.steps_per_update)

    @property
    def num_updates(self) -> int:
        """Updates in all; the last may overshoot `num_steps`."""
        return -(-self.num_steps // self.steps_per_update)


_CPU = PPOConfig(preset="cpu")
_GPU = PPOConfig(
    preset="gpu",
    num_steps=100_000_000,
    num_lots=512,
    num_minibatches=64,
    learning_rate=1e-3,
    learning_rate_end=1e-4,
    networks=NetworkConfig((256, 256), (256, 256)),
    env=EnvConfig(
        num_agents=7,
        reward=RewardConfig(crash=2.5, closeness=0.0),
    ),
)
# A square, streets with perpendicular and with parallel bays, angled bays, all of real
# size; the streets have 18 bays and more. Bays this tight are hit by chance too rarely
# to begin with: more starts near the goal, more pay for the way into the bay.
_MIXTURE = EnvConfig(
    layout="mixture",
    num_parked_cars=6,
    spawn=SpawnConfig(close_ratio=0.5),
    reward=RewardConfig(
        park=8.0, crash=1.5, progress=0.4, alignment=1.0, closeness=5.0
    ),
)
# Many updates on few data: it is agent steps that the study counts.
_STUDY = PPOConfig(
    num_steps=16_000_000,
    num_lots=128,
    unroll_length=32,
    num_minibatches=32,
    learning_rate=5e-4,
    learning_rate_end=5e-5,
    entropy_cost=3e-3,
    entropy_cost_end=3e-4,
    discount=0.995,
    networks=NetworkConfig((256, 256), (256, 256)),
)
# Fixed goals are harder: a longer view, larger networks, smaller and more steps.
_STUDY_FIXED = dataclasses.replace(
    _STUDY,
    num_epochs=6,
    learning_rate=3e-4,
    learning_rate_end=1e-5,
    entropy_cost=2e-3,
    entropy_cost_end=1e-5,
    discount=0.999,
    gae_lambda=0.95,
    networks=NetworkConfig((256, 256, 256), (256, 256, 256)),
)
# Real cars: rates, entropy and discount as tried for `cpu` and `gpu`.
_PHYSICAL = dataclasses.replace(
    _STUDY,
    learning_rate=1e-3,
    learning_rate_end=1e-4,
    entropy_cost=5e-3,
    entropy_cost_end=1e-3,
    discount=0.99,
)
_ORIGINAL = PPOConfig(
    preset="tanner-fixed-original",
    num_steps=12_800_000,
    num_lots=18,
    unroll_length=32,
    num_minibatches=126,
    num_epochs=10,
    learning_rate=1e-4,
    learning_rate_end=1e-10,
    entropy_cost=2e-3,
    entropy_cost_end=1e-5,
    clip=0.25,
    clip_end=0.1,
    discount=0.999,
    gae_lambda=0.925,
    max_grad_norm=1e9,  # he does not clip gradients
    averaged_updates=1,
    networks=NetworkConfig((256, 256, 256), (256, 256, 256)),
    env=TANNER_FIXED,
)

PRESETS: dict[str, PPOConfig] = {
    "cpu": _CPU,
    "gpu": _GPU,
    "cpu-mixture": dataclasses.replace(
        _CPU, preset="cpu-mixture", entropy_cost=3e-3, env=_MIXTURE
    ),
    "gpu-mixture": dataclasses.replace(
        _GPU,
        preset="gpu-mixture",
        env=dataclasses.replace(_MIXTURE, num_agents=4),
    ),
    "fixed": dataclasses.replace(_PHYSICAL, preset="fixed", env=FIXED),
    "dynamic": dataclasses.replace(_PHYSICAL, preset="dynamic", env=DYNAMIC),
    "tanner-fixed": dataclasses.replace(
        _STUDY_FIXED, preset="tanner-fixed", env=TANNER_FIXED
    ),
    "tanner-fixed-original": _ORIGINAL,
    "tanner-dynamic": dataclasses.replace(
        _STUDY, preset="tanner-dynamic", env=TANNER_DYNAMIC
    ),
}
