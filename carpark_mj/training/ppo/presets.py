"""Presets of PPO training.

`cpu` and `gpu` are made for a kind of hardware and end in time. The others have the
names of their environments in `carpark_mj.registry`, train real cars and are meant for
a GPU. `parts` names them.
"""

import dataclasses

from carpark_mj.config import EpisodeConfig
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.registry import environment
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig

# What all policies that drive real cars share; docs/ablations.md says what was tried.
_CURRICULUM = CurriculumConfig(crash_scale=3.0, conflict_ratio=0.3, discount_end=0.998)
# Trained within ten minutes, compiling included. On two cores learning takes the time:
# small networks, and two epochs for more steps. What finds the way into a bay early
# leaves more time for the rest: fast learning, entropy, a short horizon at the start.
CPU = PPOConfig(
    preset="cpu",
    num_steps=50_000_000,
    minutes=9.2,
    num_lots=128,
    num_epochs=2,
    learning_rate=3e-3,
    entropy_cost=1e-2,
    discount=0.98,
    curriculum=_CURRICULUM,
    networks=NetworkConfig((64, 64), (64, 64), own_size=64, entity_size=32, bins=15),
)
# Lots in plenty and short unrolls: an update has as many steps, and simulates them in
# fewer steps of more cars, which take a GPU hardly longer.
SQUARE = PPOConfig(
    preset="square",
    num_steps=3_700_000_000,
    num_lots=8192,
    lot_life=32,
    unroll_length=32,
    num_minibatches=32,
    num_epochs=2,
    half_precision=True,
    learning_rate=1e-3,
    learning_rate_end=3e-5,
    entropy_cost_end=3e-4,
    curriculum=_CURRICULUM,
    networks=NetworkConfig((256, 256), (256, 256), min_std=0.1),
    # A policy that parks precisely parks strictly, too, after as many steps.
    env=dataclasses.replace(
        environment("square"), episode=EpisodeConfig(parked_rule="precise")
    ),
)
GPU = dataclasses.replace(SQUARE, preset="gpu", num_steps=6_000_000_000, minutes=8.0)
# With dynamic goals conflicts are about bays, not collision courses: not tried, nor is
# the `min_std` of the others.
DYNAMIC = dataclasses.replace(
    SQUARE,
    preset="dynamic",
    num_steps=2_700_000_000,
    curriculum=dataclasses.replace(_CURRICULUM, conflict_ratio=0.0),
    networks=NetworkConfig((256, 256), (256, 256)),
    env=environment("dynamic"),
)
ANYWHERE = dataclasses.replace(
    SQUARE,
    preset="anywhere",
    num_steps=3_500_000_000,
    learning_rate_end=2e-5,
    curriculum=dataclasses.replace(
        _CURRICULUM,
        conflict_ratio=0.2,
        reverse_ratio=0.3,
        misaligned_ratio=0.1,
        target_rate=0.99,
        discount_end=0.997,
        neighbour_share=0.25,
    ),
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), min_std=0.1),
    env=environment("anywhere"),
)
# It parks from the start, and learns to avoid people. Where every other episode hits a
# person, a high penalty would teach it to stay where it is.
CONSIDERATE = dataclasses.replace(
    ANYWHERE,
    preset="considerate",
    warm_start="anywhere",
    critic_steps=40_000_000,
    num_steps=1_810_000_000,
    learning_rate=4e-4,
    entropy_cost=2e-3,
    discount=0.997,
    curriculum=dataclasses.replace(
        ANYWHERE.curriculum,
        crash_scale=4.0,
        discount_end=0.0,
        misaligned_ratio=0.0,  # not tried
        neighbour_share=0.0,  # not tried
    ),
    env=environment("considerate"),
)
# Pictures take the time: fewer steps in an update, and as many in all as an H200 makes
# in 21 minutes. The teacher knows all positions.
SEES = dataclasses.replace(
    ANYWHERE,
    preset="sees",
    num_steps=160_000_000,
    num_lots=1024,
    num_minibatches=8,
    learning_rate=5e-4,
    curriculum=dataclasses.replace(
        ANYWHERE.curriculum,
        misaligned_ratio=0.0,  # not tried
        neighbour_share=0.0,  # not tried; one agent alone has no neighbours
        teacher="anywhere",
        teacher_until=0.9,
    ),
    networks=NetworkConfig((256, 256), (256, 256, 256), min_std=0.1),
    env=environment("sees"),
)
