"""The preset of PPO for HOPE's levels, meant for a GPU."""

import dataclasses

from carpark_mj.config.networks import NetworkConfig
from carpark_mj.suite import hope as environments
from carpark_mj.training.ppo.presets import SQUARE

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
