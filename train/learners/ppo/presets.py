"""Presets of PPO training.

`cpu`, `gpu` and their mixtures are made for a kind of hardware. The others are the
experiments of Tanner 2022 by the names of their environments, `carpark_mj.registry`:
16 M agent steps with settings of our own, meant for a GPU.

`tanner-fixed-original` has the study's hyperparameters, table 5.1, as far as this loop
has them, for 12.8 M steps: the study's last 3.2 M of 16 M have a learning rate of about
zero. What differs:

- an update has 4032 agent steps, 32 of each of 126 agents in 18 lots; the study's has
  4096, of 7 agents in one lot, in trajectories of at most 128 steps.
- a minibatch of 32 is 32 consecutive steps of one agent, not 32 random steps, and its
  advantages are normalised by themselves, not with those of the whole update.
- the clipped ratio is that of the whole action, not of each branch; the value's change
  is not clipped, and its loss has half the weight.
- observations are normalised, and weights start as Brax starts them (LeCun).
"""

import dataclasses

from carpark_mj.config import EnvConfig, RewardConfig, SpawnConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.registry import DYNAMIC, FIXED, TANNER_DYNAMIC, TANNER_FIXED
from learners.ppo.config import PPOConfig

# With what precedes and follows it within a quarter of an hour, on any two cores.
_CPU = PPOConfig(preset="cpu", minutes=11.0)
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
# size; the streets have 18 bays and more. Exploration finds bays this tight too rarely
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
    max_grad_norm=1e9,  # the study does not clip gradients
    averaged_updates=1,
    networks=NetworkConfig((256, 256, 256), (256, 256, 256)),
    env=TANNER_FIXED,
)

PRESETS: dict[str, PPOConfig] = {
    "cpu": _CPU,
    "gpu": _GPU,
    "cpu-mixture": dataclasses.replace(
        _CPU, preset="cpu-mixture", minutes=0.0, entropy_cost=3e-3, env=_MIXTURE
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

_HARDWARE = {
    name: "CPU" if name in ("cpu", "cpu-mixture") else "GPU" for name in PRESETS
}
_HARDWARE["tanner-fixed-original"] += ", hyperparameters of the study"

SUMMARIES = {
    name: f"{_HARDWARE[name]}, {config.num_steps / 1e6:g} M steps"
    for name, config in PRESETS.items()
}
