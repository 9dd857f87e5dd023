"""The car, the task and the environments of Pandita 2022.

Numbers are those of version 1.12, `vehicle/kinematics.py` and the ranges of
`envs/parking_env.py`; `highway` physics reads nothing else.

Where the thesis and its program differ this is the program: the power of the norm is
0.5 (2 in the text), the goal is reached below 0.08 (0.09 and 0.10), the penalty of a
crash is added to the norm, and the steering angle is not observed. A timeout is no
terminal state here, though it was one there.
"""

import dataclasses
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.config import (
    ENCODERS,
    PARKED_RULES,
    REWARDS,
    EnvConfig,
    EpisodeConfig,
    ObservationConfig,
    ParkedRule,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.observations import Field
from carpark_mj.observations.sensors import observed
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.tasks.goal_pose import FEATURES, car_features, goal_features, near
from carpark_mj.types import State
from carpark_mj.vehicle import COMPACT, register_vehicle
from carpark_mj.vehicle.parameters import kerb_to_kerb

register_vehicle(
    "highway",
    dataclasses.replace(
        COMPACT,
        length=5.0,
        width=2.0,
        rear_overhang=(5.0 - COMPACT.wheelbase) / 2,
        turning_circle=kerb_to_kerb(
            COMPACT.wheelbase, COMPACT.track_width, COMPACT.tyre_width, math.pi / 4
        ),
        max_acceleration=5.0,
        max_deceleration=5.0,
        max_speed=40.0,
        max_reverse_speed=40.0,
        steering_rate=1000.0,  # at once
    ),
)


GOAL_FEATURES = tuple(
    dataclasses.replace(field, name=f"goal_{field.name}", reveals_goal=True)
    for field in FEATURES
)


@dataclasses.dataclass(frozen=True)
class PanditaObservation(ObservationConfig):
    """Nothing but the features of the own car and those of its goal."""

    encoding: str = "pandita"

    def fields(self, env: EnvConfig) -> Sequence[Field]:
        """See `ObservationConfig.fields`."""
        del env
        return FEATURES + GOAL_FEATURES

    def values(self, env: EnvConfig, state: State) -> dict[str, jax.Array]:
        """See `ObservationConfig.values`."""
        del env
        seen = car_features(observed(state)), goal_features(state)
        parts = [part for six in seen for part in jnp.split(six, 3, axis=-1)]
        names = (field.name for field in FEATURES + GOAL_FEATURES)
        return dict(zip(names, parts, strict=True))


ENCODERS.register("pandita", PanditaObservation)
REWARD = REWARDS.register("pandita", dataclasses.replace(REWARDS["pose"], crash=4.0))
# A goal reached in the last step is a timeout.
PARKED_RULES.register("pandita", ParkedRule(test=near(0.08), before_timeout=False))


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
