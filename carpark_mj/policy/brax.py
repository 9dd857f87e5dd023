"""What networks and PPO use of Brax.

Brax imports MJX, which prints that NVIDIA Warp, which it does not need, is missing; the
import in `mjx_step` is quiet, so it comes first.
"""
# ruff: noqa: F401, I001
# pyright: reportUnusedImport=false

import carpark_mj.physics.mjx_step
from brax.training import networks
from brax.training.acme import running_statistics, specs
from brax.training.agents.ppo import networks as ppo_networks
from brax.training.agents.ppo.losses import PPONetworkParams, compute_gae
from brax.training.agents.ppo.networks import PPONetworks
from brax.training.distribution import (
    IdentityPostprocessor,
    NormalTanhDistribution,
    ParametricDistribution,
    TanhBijector,
)
from brax.training.types import UInt64
