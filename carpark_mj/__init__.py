"""carpark_mj: a physics-accurate MuJoCo parking gym with Ackermann cars.

Importing the package registers the Gymnasium ids and imports nothing heavy, Gymnasium
neither: the names below load on first use, so that MuJoCo's OpenGL can still be chosen
(`carpark_mj.rendering.gl`).
"""

import importlib
from typing import Any

from carpark_mj.registration import register_environments

register_environments()

__version__ = "1.0.0"

_HOMES = {
    "ContinuousObservation": "carpark_mj.observations",
    "EnvConfig": "carpark_mj.config",
    "EpisodeConfig": "carpark_mj.config",
    "ParkingEnv": "carpark_mj.env",
    "RewardConfig": "carpark_mj.config",
    "SimConfig": "carpark_mj.config",
    "SpawnConfig": "carpark_mj.config",
    "load_policy": "carpark_mj.policy.loading",
    "make_layout": "carpark_mj.layouts",
    "parallel_env": "carpark_mj.wrappers.pettingzoo",
}

__all__ = [*sorted(_HOMES), "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'carpark_mj' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
