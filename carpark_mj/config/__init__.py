"""Frozen, validated configuration of the environment, and registries of its parts.

Settings live beside the code that reads them and are loaded on first use, as that code
in turn names `EnvConfig`. Impossible settings raise a one-sentence `ValueError`.
"""
# ruff: noqa: F403

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # only `_NAMES` are there at run time
    from carpark_mj.config.checks import *
    from carpark_mj.config.env import *
    from carpark_mj.geometry.obstacles import *
    from carpark_mj.layouts.base import *
    from carpark_mj.mdp.goals import *
    from carpark_mj.mdp.metrics import *
    from carpark_mj.mdp.rewards import *
    from carpark_mj.mdp.terminations import *
    from carpark_mj.observations.fields import *
    from carpark_mj.observations.ranges import *
    from carpark_mj.observations.sensors import *
    from carpark_mj.observations.tracked import *
    from carpark_mj.obstacles import *
    from carpark_mj.physics.config import *
    from carpark_mj.spawning.config import *

_NAMES = {
    "config.checks": "data",
    "config.env": "EnvConfig insert is_data setting",
    "geometry.obstacles": "ObstacleKind",
    "layouts.base": "LAYOUTS LayoutChoice LayoutConfig register_layout",
    "mdp.goals": "GivingWayConfig GoalConfig",
    "mdp.metrics": "METRICS Metric MetricsConfig register_metric",
    "mdp.rewards": "REWARDS REWARD_TERMS ExtraTerms GoalRewards RewardConfig "
    "RewardTerm term_settings",
    "mdp.terminations": "ENDS PARKED_RULES WORLD_UNIT End EpisodeConfig ParkedRule "
    "find_rules",
    "observations.fields": "ENCODERS ObservationConfig",
    "observations.ranges": "RayConfig RingConfig UltrasoundConfig",
    "observations.sensors": "SensorConfig",
    "observations.tracked": "ShareConfig",
    "obstacles": "MOVERS Mover",
    "physics.config": "CONTACT_SIM_DT PHYSICS PhysicsChoice PhysicsConfig SimConfig "
    "Surface",
    "spawning.config": "FleetConfig JitterConfig RandomizationConfig SpawnConfig",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"carpark_mj.{_HOMES[name]}"), name)
