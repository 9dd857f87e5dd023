"""Presets of PPO for the suite's environments, meant for a GPU."""

import dataclasses

from carpark_mj.config.networks import NetworkConfig
from carpark_mj.suite import environments
from carpark_mj.training.ppo.presets import ANYWHERE, SQUARE

# HOPE's levels: one car alone. There is nobody to collide with, and no set of cars to
# read.
HOPE = dataclasses.replace(
    SQUARE,
    preset="hope",
    num_steps=2_400_000_000,
    lot_life=16,
    unroll_length=64,
    num_epochs=4,
    half_precision=False,
    curriculum=dataclasses.replace(
        SQUARE.curriculum,
        crash_scale=2.0,
        conflict_ratio=0.0,
        reverse_ratio=0.5,
        target_rate=0.99,
    ),
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), encoder="flat"),
    env=environments.HOPE,
)

# One car alone in very different scenes. Drawing them compiles for minutes, so lots are
# stored. With one agent a lot a GPU has time for more lots than `anywhere` has.
VALET = dataclasses.replace(
    ANYWHERE,
    preset="valet",
    num_steps=1_570_000_000,
    num_lots=16384,
    stored_lots=12_288,
    num_minibatches=64,
    curriculum=dataclasses.replace(
        ANYWHERE.curriculum,
        conflict_ratio=0.0,
        reverse_ratio=0.4,
        neighbour_share=0.0,
    ),
    env=environments.VALET,
)
