"""MetaDrive's multi-agent parking lot as an environment."""

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    GoalConfig,
    SpawnConfig,
)
from carpark_mj.registry import ENVIRONMENTS

# MetaDrive's multi-agent parking lot: 10 agents, 100 s; docs/metadrive.md says what
# differs. Starts keep a car's length apart, or as far as they can.
METADRIVE = EnvConfig(
    layout="metadrive",
    num_agents=10,
    num_parked_cars=0,
    goals=GoalConfig(drive_out=True),
    spawn=SpawnConfig(close_ratio=0.0, min_distance=4.6, num_candidates=64),
    episode=EpisodeConfig(parked_rule="metadrive", max_steps=500),
)

ENVIRONMENTS.register("metadrive", METADRIVE)
