"""The environments of Pandita 2022."""

import dataclasses

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.registry import ENVIRONMENTS
from carpark_papers.pandita.task import REWARD, PanditaObservation

# Pandita 2022: highway-env's car in a lot where all other slots are taken; 150 steps at
# 5 Hz.
PANDITA = EnvConfig(
    layout="slots",
    vehicle="highway",
    num_agents=1,
    num_parked_cars=11,
    physics="highway",
    sim=SimConfig(sim_dt=1 / 15, trace_dt=1 / 15),
    spawn=SpawnConfig(close_ratio=0.0),
    episode=EpisodeConfig(parked_rule="pandita", max_steps=150),
    reward=REWARD,
    observation=PanditaObservation(),
)
# The same for real cars.
SLOTS = dataclasses.replace(PANDITA, vehicle="compact", physics="mjx", sim=SimConfig())

ENVIRONMENTS.register("pandita", PANDITA)
ENVIRONMENTS.register("slots", SLOTS)
