"""Spaces of Gymnasium environments with one agent each."""

from functools import cache, partial
from typing import Any

import numpy as np
from gymnasium import spaces

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import Field, make_fields
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
    """Space of the observation.

    A dictionary for goal environments, and if fields have shapes: these by their names,
    and the `vector` of all others.
    """
    box = partial(agent_spaces.observation_space, env.config)
    if isinstance(env, GoalParking):
        goal = box(env.goal_fields)
        return spaces.Dict(
            observation=box(env.fields), achieved_goal=goal, desired_goal=goal
        )
    vector, arrays = _arrays(env.config)
    if not arrays:
        return box()
    parts: dict[str, spaces.Space[Any]] = {
        "vector": box([field for _, field in vector])
    }
    parts |= {field.name: _shaped(box([field]), field.shape) for _, field in arrays}
    return spaces.Dict(parts)


def _shaped(row: spaces.Box, shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(row.low.reshape(shape), row.high.reshape(shape), dtype=np.float32)


Places = tuple[tuple[slice, Field], ...]


@cache
def _arrays(config: EnvConfig) -> tuple[Places, Places]:
    """Fields and where they are in the vector: those without a shape, and with one."""
    places: tuple[list[tuple[slice, Field]], ...] = ([], [])
    begin = 0
    for field in make_fields(config):
        places[bool(field.shape)].append((slice(begin, begin + field.size), field))
        begin += field.size
    return tuple(places[0]), tuple(places[1])


def split_observation(env: ParkingEnv, vector: np.ndarray) -> Any:
    """Observations (...) of `observation_space` from the vectors (..., size) of it."""
    if isinstance(env, GoalParking):
        return env.split(vector)
    rest, arrays = _arrays(env.config)
    if not arrays:
        return vector
    shaped = {
        field.name: vector[..., place].reshape(*vector.shape[:-1], *field.shape)
        for place, field in arrays
    }
    flat = np.concatenate([vector[..., place] for place, _ in rest], axis=-1)
    return {"vector": flat} | shaped
