"""What networks and PPO use of Brax, without its simulator.

Names of the package `brax` itself need MJX, trimesh and SciPy, a quarter of the time of
all imports. Here they wait until somebody asks for one.
"""
# ruff: noqa: E402, F401
# pyright: reportUnusedImport=false

import importlib.metadata
import importlib.util
import sys
from typing import Any


def _load(name: str) -> Any:
    if name not in ("Motion", "State", "System", "Transform"):
        raise AttributeError(f"module 'brax' has no attribute {name!r}")
    import carpark_mj.physics.mjx_step  # quiet about missing Warp

    return getattr(importlib.import_module("brax.base"), name)


if "brax" not in sys.modules and (found := importlib.util.find_spec("brax")):
    sys.modules["brax"] = importlib.util.module_from_spec(found)
    version = importlib.metadata.version("brax")
    vars(sys.modules["brax"]).update(__getattr__=_load, __version__=version)

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
