"""carpark_mj: a physics-accurate MuJoCo parking gym with Ackermann cars.

Importing the package registers the Gymnasium ids and imports nothing heavy, Gymnasium
neither: the names below load on first use, so that MuJoCo's OpenGL can still be chosen
(`carpark_mj.rendering.gl`).
"""

import importlib
from typing import TYPE_CHECKING, Any

from carpark_mj.registration import register_environments

register_environments()

__version__ = "1.0.0"

if TYPE_CHECKING:  # for editors; at run time names come from `_NAMES`
    from carpark_mj.config import EnvConfig as EnvConfig
    from carpark_mj.config import EpisodeConfig as EpisodeConfig
    from carpark_mj.config import RewardConfig as RewardConfig
    from carpark_mj.config import SimConfig as SimConfig
    from carpark_mj.config import SpawnConfig as SpawnConfig
    from carpark_mj.env import ParkingEnv as ParkingEnv
    from carpark_mj.layouts import make_layout as make_layout
    from carpark_mj.observations import ContinuousObservation as ContinuousObservation
    from carpark_mj.policy.host import from_function as from_function
    from carpark_mj.policy.host import from_sb3 as from_sb3
    from carpark_mj.policy.host import from_torch as from_torch
    from carpark_mj.policy.loading import load_policy as load_policy
    from carpark_mj.training import evaluate as evaluate
    from carpark_mj.training import render as render
    from carpark_mj.wrappers.pettingzoo import parallel_env as parallel_env

_NAMES = {
    "config": "EnvConfig EpisodeConfig RewardConfig SimConfig SpawnConfig",
    "env": "ParkingEnv",
    "layouts": "make_layout",
    "observations": "ContinuousObservation",
    "policy.host": "from_function from_sb3 from_torch",
    "policy.loading": "load_policy",
    "training": "evaluate render",
    "wrappers.pettingzoo": "parallel_env",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = [*sorted(_HOMES), "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'carpark_mj' has no attribute {name!r}")
    from carpark_mj.extensions import naming_extras

    with naming_extras():
        return getattr(importlib.import_module(f"carpark_mj.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
