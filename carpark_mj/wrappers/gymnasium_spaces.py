"""Gymnasium's spaces of an agent's observations and actions."""

from typing import Any

import numpy as np
from gymnasium import spaces

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import make_fields
from carpark_mj.observations.fields import Field
from carpark_mj.wrappers.batch import LotEnv
from carpark_mj.wrappers.goal import GoalParking


def action_space(spec: ActionSpec) -> spaces.Space[Any]:
    """Numbers in [-1, 1], or indices (`grid` physics).

    Raises:
        ValueError: actions of numbers and indices, which no array holds.
    """
    if spec.continuous and spec.choices:
        raise ValueError(
            "goals.dynamic must be False except with physics 'grid': an array cannot "
            "hold the controls of a car and the index of a goal"
        )
    if spec.choices:
        return spaces.MultiDiscrete([*spec.choices], dtype=np.int32)
    return spaces.Box(-1.0, 1.0, (spec.continuous,), np.float32)


def observation_space(env: LotEnv) -> spaces.Space[Any]:
    """The ranges of the fields; of a goal environment a dictionary."""
    if isinstance(env, GoalParking):
        goal = _box(env.goal_fields)
        return spaces.Dict(
            observation=_box(env.fields), achieved_goal=goal, desired_goal=goal
        )
    return _box(make_fields(env.config))


def split_observation(env: LotEnv, vector: np.ndarray) -> Any:
    """Observations (...) of `observation_space` from the vectors (..., size) of it."""
    return env.split(vector) if isinstance(env, GoalParking) else vector


def _box(fields: tuple[Field, ...]) -> spaces.Box:
    sizes = [field.size for field in fields]
    low = np.repeat([field.low for field in fields], sizes)
    high = np.repeat([field.high for field in fields], sizes)
    return spaces.Box(low.astype(np.float32), high.astype(np.float32))
