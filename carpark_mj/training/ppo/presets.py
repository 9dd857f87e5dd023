"""Presets of PPO training.

`cpu` and `gpu` are made for a kind of hardware and end in time. The others have the
names of their environments in `carpark_mj.registry` and are meant for a GPU: `square`,
`dynamic`, `anywhere` and `hope` train real cars, the rest are the experiments of Tanner
2022, 16 M agent steps with settings of our own.

`tanner-fixed-original` and `tanner-dynamic-original` have the study's hyperparameters,
table 5.1, and the details of its trainer (`ml_agents`), for 12.8 M steps: the
study's last 3.2 M of 16 M have a learning rate of about zero. What differs:

- an update has 4032 agent steps, 32 of each of 126 agents in 18 lots; the study's has
  4096, of 7 agents in one lot, in trajectories of at most 128 steps.
- a timed-out step is masked, as in all our PPO; the study bootstraps from it.
"""

import dataclasses

from carpark_mj.config import EpisodeConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.registry import (
    ANYWHERE,
    DYNAMIC,
    HOPE,
    SQUARE,
    TANNER_DYNAMIC,
    TANNER_FIXED,
)
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.curriculum_config import CurriculumConfig

# What all policies that drive real cars share; docs/results.md says what was tried.
_CURRICULUM = CurriculumConfig(crash_scale=3.0, crash_ratio=0.3, discount_end=0.998)
# Meant to end within a quarter of an hour, evaluation and video included. On two cores
# learning takes the time: small networks, and two epochs for more steps.
_CPU = PPOConfig(
    preset="cpu",
    num_steps=50_000_000,
    minutes=12.0,
    num_epochs=2,
    curriculum=_CURRICULUM,
    networks=NetworkConfig(
        (64, 64), (64, 64), own_size=64, entity_size=32, min_std=0.1
    ),
)
_SQUARE = PPOConfig(
    preset="square",
    num_steps=1_500_000_000,
    num_lots=1024,
    num_minibatches=64,
    learning_rate=1e-3,
    learning_rate_end=3e-5,
    entropy_cost_end=3e-4,
    curriculum=_CURRICULUM,
    networks=NetworkConfig((256, 256), (256, 256), min_std=0.1),
    # Who parks precisely parks strictly, too, and learns it in the same time.
    env=dataclasses.replace(SQUARE, episode=EpisodeConfig(parked_rule="precise")),
)
_GPU = dataclasses.replace(_SQUARE, preset="gpu", minutes=8.0)
# With chosen goals `crash_ratio` means starts in conflict over a bay: not tried, nor is
# the `min_std` of the others.
_DYNAMIC = dataclasses.replace(
    _SQUARE,
    preset="dynamic",
    num_steps=1_000_000_000,
    curriculum=dataclasses.replace(_CURRICULUM, crash_ratio=0.0),
    networks=NetworkConfig((256, 256), (256, 256)),
    env=DYNAMIC,
)
# 2,048 lots fill one GPU; two train with twice as many (docs/policies.md).
_ANYWHERE = dataclasses.replace(
    _SQUARE,
    preset="anywhere",
    num_steps=4_000_000_000,
    num_lots=2048,
    num_minibatches=32,
    learning_rate_end=2e-5,
    curriculum=dataclasses.replace(
        _CURRICULUM,
        crash_ratio=0.2,
        reverse_ratio=0.3,
        target_rate=0.99,
        discount_end=0.997,
    ),
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), min_std=0.1),
    env=ANYWHERE,
)
# One car alone: there is nobody to collide with, and no set of cars to read.
_HOPE = dataclasses.replace(
    _SQUARE,
    preset="hope",
    num_steps=800_000_000,
    num_lots=8192,
    num_minibatches=32,
    curriculum=dataclasses.replace(
        _CURRICULUM,
        crash_scale=2.0,
        crash_ratio=0.0,
        reverse_ratio=0.5,
        target_rate=0.99,
    ),
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), encoder="flat"),
    env=HOPE,
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
    networks=NetworkConfig((256, 256), (256, 256), encoder="flat"),
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
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), encoder="flat"),
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
    max_grad_norm=1e9,  # the study does not clip gradients
    variant="ml-agents",
    averaged_updates=1,
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), encoder="flat"),
    env=TANNER_FIXED,
)

PRESETS: dict[str, PPOConfig] = {
    "cpu": _CPU,
    "gpu": _GPU,
    "square": _SQUARE,
    "dynamic": _DYNAMIC,
    "anywhere": _ANYWHERE,
    "hope": _HOPE,
    "tanner-fixed": dataclasses.replace(
        _STUDY_FIXED, preset="tanner-fixed", env=TANNER_FIXED
    ),
    "tanner-fixed-original": _ORIGINAL,
    "tanner-dynamic": dataclasses.replace(
        _STUDY, preset="tanner-dynamic", env=TANNER_DYNAMIC
    ),
    "tanner-dynamic-original": dataclasses.replace(
        _ORIGINAL, preset="tanner-dynamic-original", env=TANNER_DYNAMIC
    ),
}

_HARDWARE = {name: "CPU" if name == "cpu" else "GPU" for name in PRESETS}
for _name in ("tanner-fixed-original", "tanner-dynamic-original"):
    _HARDWARE[_name] += ", hyperparameters of the study"

SUMMARIES = {
    name: f"{_HARDWARE[name]}, {config.num_steps / 1e6:g} M steps"
    + (f" or {config.minutes:g} min" if config.minutes else "")
    for name, config in PRESETS.items()
}
