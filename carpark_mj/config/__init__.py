"""Frozen, validated configuration of the environment: the only home of its defaults.

Impossible settings raise a one-sentence `ValueError` at construction.
"""

from carpark_mj.config.back_ends import (
    PHYSICS,
    PhysicsChoice,
    PhysicsConfig,
    physics_config,
)
from carpark_mj.config.env import EnvConfig
from carpark_mj.config.fleet import FleetConfig, JitterConfig
from carpark_mj.config.giving_way import ContextName, GivingWayConfig, Scheme
from carpark_mj.config.goals import GoalConfig, GoalRewards
from carpark_mj.config.insertion import data, insert, is_data, setting
from carpark_mj.config.layouts import (
    LAYOUTS,
    LayoutChoice,
    LayoutConfig,
    register_layout,
    require_layout,
)
from carpark_mj.config.metrics import METRICS, Metric, MetricsConfig, register_metric
from carpark_mj.config.observations import (
    ENCODERS,
    ObservationConfig,
    RayConfig,
    RingConfig,
    SensorConfig,
    ShareConfig,
    UltrasoundConfig,
)
from carpark_mj.config.obstacles import MOVERS, Mover, ObstacleKind
from carpark_mj.config.physics import CONTACT_SIM_DT, SimConfig, Surface, TyresName
from carpark_mj.config.randomization import RandomizationConfig
from carpark_mj.config.reward_terms import (
    REWARD_TERMS,
    ExtraTerms,
    RewardTerm,
    term_settings,
)
from carpark_mj.config.rewards import REWARDS, RewardConfig
from carpark_mj.config.spawning import RelocationRule, SpawnConfig
from carpark_mj.config.terminations import (
    PARKED_RULES,
    WORLD_UNIT,
    EpisodeConfig,
    ParkedRule,
    find_rules,
)

__all__ = [
    "CONTACT_SIM_DT",
    "ENCODERS",
    "LAYOUTS",
    "METRICS",
    "MOVERS",
    "PARKED_RULES",
    "PHYSICS",
    "REWARDS",
    "REWARD_TERMS",
    "WORLD_UNIT",
    "ContextName",
    "EnvConfig",
    "EpisodeConfig",
    "ExtraTerms",
    "FleetConfig",
    "GivingWayConfig",
    "GoalConfig",
    "GoalRewards",
    "JitterConfig",
    "LayoutChoice",
    "LayoutConfig",
    "Metric",
    "MetricsConfig",
    "Mover",
    "ObservationConfig",
    "ObstacleKind",
    "ParkedRule",
    "PhysicsChoice",
    "PhysicsConfig",
    "RandomizationConfig",
    "RayConfig",
    "RelocationRule",
    "RewardConfig",
    "RewardTerm",
    "RingConfig",
    "Scheme",
    "SensorConfig",
    "ShareConfig",
    "SimConfig",
    "SpawnConfig",
    "Surface",
    "TyresName",
    "UltrasoundConfig",
    "data",
    "find_rules",
    "insert",
    "is_data",
    "physics_config",
    "register_layout",
    "register_metric",
    "require_layout",
    "setting",
    "term_settings",
]
