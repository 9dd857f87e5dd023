"""The observation vector of an environment: its encoding's values in declared order."""

import dataclasses
from collections.abc import Iterable

import jax
import jax.numpy as jnp

from carpark_mj.config import (
    ContinuousObservation,
    EnvConfig,
    Observation,
    TannerObservation,
)
from carpark_mj.observations.continuous import continuous_fields, continuous_values
from carpark_mj.observations.fields import Field
from carpark_mj.observations.indices import index_fields, index_values
from carpark_mj.observations.tanner import tanner_fields, tanner_values
from carpark_mj.studies.tanner.grid_config import grid_scale
from carpark_mj.types import State


def make_fields(config: EnvConfig) -> tuple[Field, ...]:
    """Lists the fields of the observation vector in order.

    `observe`, the vector's size and the table in the documentation all read them.
    """
    observation, goals = slots(config), config.goals
    num_tracked_bays = goals.num_tracked_bays if goals.dynamic else 0
    if isinstance(observation, ContinuousObservation):
        return tuple(continuous_fields(observation, num_tracked_bays))
    if isinstance(observation, TannerObservation):
        return tuple(tanner_fields(observation, num_tracked_bays))
    return tuple(index_fields(observation, grid_scale(config)))


def observe(config: EnvConfig, state: State) -> jax.Array:
    """What the agents of a lot observe, (num_agents, observation_size) float32.

    Absent agents observe zeros.
    """
    observation, ctrl_dt = slots(config), config.sim.ctrl_dt
    if isinstance(observation, ContinuousObservation):
        values = continuous_values(observation, state)
    elif isinstance(observation, TannerObservation):
        values = tanner_values(observation, grid_scale(config), ctrl_dt, state)
    else:
        values = index_values(observation, grid_scale(config), ctrl_dt, state)
    ordered = [values.pop(field.name) for field in make_fields(config)]
    if values:
        raise AssertionError(f"undeclared observation fields: {sorted(values)}")
    vector = jnp.concatenate(ordered, axis=-1).astype(jnp.float32)
    if state.present is None:
        return vector
    return jnp.where(state.present[:, None], vector, 0.0)


def slots(config: EnvConfig) -> Observation:
    """The observation with as many slots as the lot's cars can fill.

    One slot stays where there are no such cars, so that a network that reads sets of
    cars has the same weights whatever their number.
    """
    observation = config.observation
    if not isinstance(observation, ContinuousObservation):
        return observation
    agents, parked = max(config.num_agents - 1, 1), max(config.num_parked_cars, 1)
    return dataclasses.replace(
        observation,
        tracked_agents=min(observation.tracked_agents, agents),
        tracked_parked_cars=min(observation.tracked_parked_cars, parked),
    )


def observation_size(config: EnvConfig) -> int:
    """Length of an agent's observation."""
    return sum(field.size for field in make_fields(config))


def markdown_table(fields: Iterable[Field]) -> str:
    """Fields as a markdown table; of repeated entities the first."""
    rows = ["| field | size | range | meaning [unit] |", "|---|---|---|---|"]
    rows += [
        f"| `{field.name}` | {field.size} | {field.low:g} … {field.high:g} | "
        f"{field.meaning} |"
        for field in fields
        if field.index == 0
    ]
    return "\n".join(rows)
