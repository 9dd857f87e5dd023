"""The three-way junction of Cederle 2023: automated cars and a human-driven one."""

from carpark_papers.cederle.junction.config import (
    SCENARIOS,
    JunctionConfig,
    RasterConfig,
    RewardRules,
    scenario,
)
from carpark_papers.cederle.junction.env import JunctionEnv

__all__ = [
    "SCENARIOS",
    "JunctionConfig",
    "JunctionEnv",
    "RasterConfig",
    "RewardRules",
    "scenario",
]
