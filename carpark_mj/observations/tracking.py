"""Who and what an agent tracks: the nearest within its view."""

import jax
import jax.numpy as jnp

from carpark_mj.config import (
    ContinuousObservation,
    EnvConfig,
    IndexObservation,
    TannerObservation,
    ViewConfig,
)
from carpark_mj.geometry import nearest, norm, rotate
from carpark_mj.observations.sensors import observed
from carpark_mj.types import ParkedCars, State


def in_view(config: ViewConfig, own_pose: jax.Array, xy: jax.Array) -> jax.Array:
    """Whether points lie in the field of view and the tracking circle of every agent.

    Args:
        config: limits of the view.
        own_pose: (num_agents, 3) observers.
        xy: (n, 2) points, or (num_agents, n, 2) points of each agent's own.

    Returns:
        (num_agents, n) bool.
    """
    offset = xy - own_pose[:, None, :2]
    seen = jnp.ones(offset.shape[:-1], bool)
    if config.diameter is not None:
        seen = seen & (norm(offset) <= config.diameter / 2)
    if config.field_of_view < 360.0:
        local = rotate(offset, -own_pose[:, None, 2])
        bearing = jnp.arctan2(local[..., 1], local[..., 0])
        seen = seen & (jnp.abs(bearing) <= jnp.radians(config.field_of_view / 2))
    return seen


def track_agents(
    config: ContinuousObservation, own_pose: jax.Array, present: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """The nearest other agents.

    Args:
        config: how many, and the view.
        own_pose: (num_agents, 3).
        present: (num_agents,) bool, see `State.present`.

    Returns:
        Indices and presence (num_agents, tracked_agents), see `geometry.nearest`.
    """
    xy = own_pose[:, :2]
    mask = _others(xy.shape[0], present) & in_view(config.view, own_pose, xy)
    return nearest(xy, xy, mask, config.tracked_agents)


def track_parked_cars(
    config: ContinuousObservation, own_pose: jax.Array, parked_cars: ParkedCars
) -> tuple[jax.Array, jax.Array]:
    """The nearest parked cars.

    Args:
        config: how many, and the view.
        own_pose: (num_agents, 3) observers.
        parked_cars: (num_parked_cars,) of the lot.

    Returns:
        Indices and presence (num_agents, tracked_parked_cars), see `geometry.nearest`.
    """
    xy = parked_cars.pose_w[:, :2]
    mask = parked_cars.present & in_view(config.view, own_pose, xy)
    return nearest(own_pose[:, :2], xy, mask, config.tracked_parked_cars)


def track_cars(
    config: TannerObservation,
    own_pose: jax.Array,
    parked_cars: ParkedCars,
    present: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The nearest among the other agents and parked cars together.

    Args:
        config: how many, and the view.
        own_pose: (num_agents, 3) observers.
        parked_cars: (num_parked_cars,) of the lot.
        present: (num_agents,) bool, see `State.present`.

    Returns:
        Indices and presence (num_agents, tracked_cars), see `geometry.nearest`; indices
        count the agents first, then the parked cars.
    """
    own_xy, count = own_pose[:, :2], own_pose.shape[0]
    others = _others(count, present)
    parked = jnp.broadcast_to(parked_cars.present, (count, *parked_cars.present.shape))
    xy = jnp.concatenate([own_xy, parked_cars.pose_w[:, :2]])
    mask = jnp.concatenate([others, parked], axis=1)
    mask = mask & in_view(config.view, own_pose, xy)
    return nearest(own_xy, xy, mask, config.tracked_cars)


def _others(count: int, present: jax.Array | None) -> jax.Array:
    """(count, count) bool, [i, j] whether j is another agent and present."""
    others = ~jnp.eye(count, dtype=bool)
    return others if present is None else others & present


def tracks(config: EnvConfig, state: State) -> jax.Array:
    """Whether agents track each other, as far as their sensors tell.

    Returns:
        (num_agents, num_agents) bool, [i, j] whether i tracks j.
    """
    observation, pose = config.observation, observed(state).pose_w
    agents = jnp.arange(pose.shape[0])
    if isinstance(observation, TannerObservation) and observation.tracked_cars:
        index, present = track_cars(observation, pose, state.parked_cars, state.present)
    elif isinstance(observation, ContinuousObservation) and observation.tracked_agents:
        index, present = track_agents(observation, pose, state.present)
    else:
        return jnp.zeros((pose.shape[0],) * 2, bool)
    return jnp.any((index[..., None] == agents) & present[..., None], axis=1)


def tracks_parked_cars(config: EnvConfig, state: State) -> jax.Array:
    """Whether agents track parked cars, as far as their sensors tell.

    Returns:
        (num_agents, num_parked_cars) bool.
    """
    observation, pose = config.observation, observed(state).pose_w
    cars, shift = jnp.arange(state.parked_cars.bay.shape[0]), 0
    if isinstance(observation, TannerObservation) and observation.tracked_cars:
        index, present = track_cars(observation, pose, state.parked_cars, state.present)
        shift = pose.shape[0]  # agents come first in that list
    elif (
        isinstance(observation, ContinuousObservation)
        and observation.tracked_parked_cars
    ):
        index, present = track_parked_cars(observation, pose, state.parked_cars)
    else:
        return jnp.zeros((pose.shape[0], cars.shape[0]), bool)
    if state.present is not None:
        present = present & state.present[:, None]
    same = index[..., None] == cars + shift
    return jnp.any(same & present[..., None], axis=1)


def bays_in_view(config: EnvConfig, state: State) -> jax.Array | None:
    """Bays that agents can track, by where they truly are.

    Returns:
        (num_agents, bays) bool; None if all are in view always.
    """
    observation = config.observation
    if isinstance(observation, IndexObservation) or not observation.view.is_limited:
        return None
    bay_xy = state.layout.bay_pose[:, :2]
    return in_view(observation.view, state.motion.pose_w, bay_xy)
