"""Presets of PPO for the experiments of Tanner 2022, meant for a GPU.

`tanner-fixed` and `tanner-dynamic` are of 16 M agent steps, with settings of our own.
`tanner-fixed-original` and `tanner-dynamic-original` have the study's hyperparameters,
table 5.1, and the details of its trainer (`ml_agents`), for 12.8 M steps: the study's
last 3.2 M of 16 M have a learning rate of about zero. What differs:

- an update has 4032 agent steps, 32 of each of 126 agents in 18 lots; the study's has
  4096, of 7 agents in one lot, in trajectories of at most 128 steps.
- a timed-out step is masked, as in all our PPO; the study bootstraps from it.
"""

import dataclasses

from carpark_mj.config.networks import NetworkConfig
from carpark_mj.registry import environment
from carpark_mj.training.ppo.config import PPOConfig

# Many updates on few data: it is agent steps that the study counts.
DYNAMIC = PPOConfig(
    preset="tanner-dynamic",
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
    env=environment("tanner-dynamic"),
)
# Fixed goals are harder: a longer view, larger networks, smaller and more steps.
FIXED = dataclasses.replace(
    DYNAMIC,
    preset="tanner-fixed",
    env=environment("tanner-fixed"),
    num_epochs=6,
    learning_rate=3e-4,
    learning_rate_end=1e-5,
    entropy_cost=2e-3,
    entropy_cost_end=1e-5,
    discount=0.999,
    gae_lambda=0.95,
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), encoder="flat"),
)
FIXED_ORIGINAL = PPOConfig(
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
    env=environment("tanner-fixed"),
)

DYNAMIC_ORIGINAL = dataclasses.replace(
    FIXED_ORIGINAL, preset="tanner-dynamic-original", env=environment("tanner-dynamic")
)
