"""The three-way junction of Cederle 2023: automated cars and a human-driven one."""

from carpark_papers.cederle.junction.config import (
    JunctionConfig,
    RasterConfig,
    RewardRules,
)
from carpark_papers.cederle.junction.env import JunctionEnv
from carpark_papers.cederle.junction.scenarios import SCENARIOS, scenario

__all__ = [
    "SCENARIOS",
    "JunctionConfig",
    "JunctionEnv",
    "RasterConfig",
    "RewardRules",
    "scenario",
]
