"""Frozen, validated configuration of the environment: the only home of its defaults.

Impossible settings raise `ValueError` at construction, in one sentence.
"""

from carpark_mj.config.env import EnvConfig, PhysicsName
from carpark_mj.config.fleet import FleetConfig, JitterConfig
from carpark_mj.config.goals import GoalConfig
from carpark_mj.config.grid import WORLD_UNIT, GridConfig
from carpark_mj.config.layout import (
    LAYOUT_FILES,
    LayoutChoice,
    LayoutConfig,
    LayoutName,
)
from carpark_mj.config.observation import (
    TANNER_OBSERVATION,
    BayPart,
    Encoding,
    ObservationConfig,
)
from carpark_mj.config.reward import REWARDS, RewardConfig, RewardName, reward_preset
from carpark_mj.config.simulation import CONTACT_SIM_DT, SimConfig, Surface, TyresName
from carpark_mj.config.task import (
    EpisodeConfig,
    ParkedRule,
    SpawnConfig,
)
from carpark_mj.config.variation import (
    Distribution,
    DistributionKind,
    RandomisationConfig,
    SensorConfig,
)

__all__ = [
    "CONTACT_SIM_DT",
    "LAYOUT_FILES",
    "REWARDS",
    "TANNER_OBSERVATION",
    "WORLD_UNIT",
    "BayPart",
    "Distribution",
    "DistributionKind",
    "Encoding",
    "EnvConfig",
    "EpisodeConfig",
    "FleetConfig",
    "GoalConfig",
    "GridConfig",
    "JitterConfig",
    "LayoutChoice",
    "LayoutConfig",
    "LayoutName",
    "ObservationConfig",
    "ParkedRule",
    "PhysicsName",
    "RandomisationConfig",
    "RewardConfig",
    "RewardName",
    "SensorConfig",
    "SimConfig",
    "SpawnConfig",
    "Surface",
    "TyresName",
    "reward_preset",
]
