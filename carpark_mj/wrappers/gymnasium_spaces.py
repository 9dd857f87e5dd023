"""Spaces of Gymnasium environments with one agent each."""

from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces

from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.wrappers import spaces as agent_spaces
from carpark_mj.wrappers.goal import GoalParking


def action_space(spec: ActionSpec) -> spaces.Space[Any]:
    """Numbers in [-1, 1], or indices.

    Raises:
        ValueError: actions have both numbers and indices.
    """
    if spec.continuous and spec.choices:
        raise ValueError(
            "an array holds numbers or indices: goals.dynamic must be False except "
            "with physics whose controls are indices"
        )
    return agent_spaces.action_space(spec)


def observation_space(env: ParkingEnv) -> spaces.Space[Any]:
    """Space of the observation; a dictionary for goal environments."""
    box = partial(agent_spaces.observation_space, env.config)
    if isinstance(env, GoalParking):
        goal = box(env.goal_fields)
        return spaces.Dict(
            observation=box(env.fields), achieved_goal=goal, desired_goal=goal
        )
    return box()


def split_observation(env: ParkingEnv, vector: np.ndarray) -> Any:
    """Observations (...) of `observation_space` from the vectors (..., size) of it."""
    return env.split(vector) if isinstance(env, GoalParking) else vector
