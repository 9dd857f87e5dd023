"""What networks and PPO use of Brax, without its simulator.

The package `brax` begins with names that need MJX, trimesh and SciPy, a quarter of the
time of all imports. Here they wait until somebody asks for one.
"""
# ruff: noqa: E402, F401
# pyright: reportUnusedImport=false

import importlib.util
import sys
from typing import Any


def _load(name: str) -> Any:
    package = sys.modules["brax"]
    del vars(package)["__getattr__"]
    package.__spec__.loader.exec_module(package)  # pyright: ignore
    return getattr(package, name)


if "brax" not in sys.modules and (found := importlib.util.find_spec("brax")):
    sys.modules["brax"] = importlib.util.module_from_spec(found)
    vars(sys.modules["brax"])["__getattr__"] = _load

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
