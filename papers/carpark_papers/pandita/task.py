"""The task of Pandita 2022: twelve numbers observed, and the ends of the thesis.

Where the thesis and its program differ this is the program: the power of the norm is
0.5 (2 in the text), the goal is reached below 0.08 (0.09 and 0.10), the penalty of a
crash is added to the norm, and the steering angle is not observed. A timeout is no
terminal state here, though it was one there.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.config import (
    ENCODERS,
    PARKED_RULES,
    REWARDS,
    EnvConfig,
    ObservationConfig,
    ParkedRule,
)
from carpark_mj.observations import Field
from carpark_mj.observations.sensors import observed
from carpark_mj.tasks.goal_pose import FEATURES, car_features, goal_features, near
from carpark_mj.types import State

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
