"""HOPE's levels as an environment (Jiang et al. 2024, arXiv 2405.20579)."""

import dataclasses

from carpark_mj.config import (
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    RandomizationConfig,
    RayConfig,
    SensorConfig,
    SpawnConfig,
)
from carpark_mj.observations import ContinuousObservation
from carpark_mj.registry import ANYWHERE, ENVIRONMENTS

# HOPE's levels (docs/hard_cases.md): one car without noise among boxes, seen by rays.
HOPE = dataclasses.replace(
    ANYWHERE,
    layout="hope_normal_perpendicular,hope_normal_parallel,hope_complex_perpendicular,"
    "hope_complex_parallel,hope_extreme_parallel",
    vehicle="tpcap",
    num_agents=1,
    min_agents=None,
    num_parked_cars=0,
    occupancy=None,
    fleet=FleetConfig(),
    jitter=JitterConfig(),
    spawn=SpawnConfig(close_ratio=0.0),
    episode=EpisodeConfig(max_steps=500),  # 100 s, as in the suite
    observation=ContinuousObservation(
        tracked_agents=0,
        tracked_parked_cars=0,
        own_car=True,
        lines=True,
        rays=RayConfig(72, near=1.0),
    ),
    randomization=RandomizationConfig(),
    sensors=SensorConfig(),
)

ENVIRONMENTS.register("hope", HOPE)
