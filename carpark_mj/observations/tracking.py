"""Who and what an agent tracks: the nearest within its view."""

import jax
import jax.numpy as jnp

from carpark_mj.config import ObservationConfig
from carpark_mj.geometry import rotate
from carpark_mj.observations.localised import nearest


def in_view(config: ObservationConfig, own_pose: jax.Array, xy: jax.Array) -> jax.Array:
    """Whether points lie in the field of view and the tracking circle of every agent.

    Args:
        config: `field_of_view` and `tracking_diameter`.
        own_pose: (num_agents, 3) observers.
        xy: (n, 2) points, or (num_agents, n, 2) points of each agent's own.

    Returns:
        (num_agents, n) bool.
    """
    offset = xy - own_pose[:, None, :2]
    seen = jnp.ones(offset.shape[:-1], bool)
    if config.tracking_diameter is not None:
        radius = config.tracking_diameter / 2
        seen = seen & (jnp.linalg.norm(offset, axis=-1) <= radius)
    if config.field_of_view < 360.0:
        local = rotate(offset, -own_pose[:, None, 2])
        bearing = jnp.arctan2(local[..., 1], local[..., 0])
        seen = seen & (jnp.abs(bearing) <= jnp.radians(config.field_of_view / 2))
    return seen


def track_agents(
    config: ObservationConfig, own_pose: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The nearest `tracked_agents` other agents, see `nearest`."""
    xy = own_pose[:, :2]
    mask = ~jnp.eye(xy.shape[0], dtype=bool) & in_view(config, own_pose, xy)
    return nearest(xy, xy, mask, config.tracked_agents)


def track_cars(
    config: ObservationConfig,
    own_pose: jax.Array,
    parked_xy: jax.Array,
    parked_present: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The nearest `tracked_cars` among the other agents and parked cars together.

    Args:
        config: what is tracked.
        own_pose: (num_agents, 3) observers.
        parked_xy: (num_parked_cars, 2).
        parked_present: (num_parked_cars,) bool, cars that exist; None = all.

    Returns:
        Indices and presence (num_agents, tracked_cars), see `nearest`; indices count
        the agents first, then the parked cars.
    """
    if parked_present is None:
        parked_present = jnp.ones(parked_xy.shape[0], bool)
    own_xy, count = own_pose[:, :2], own_pose.shape[0]
    others = ~jnp.eye(count, dtype=bool)
    parked = jnp.broadcast_to(parked_present, (count, parked_xy.shape[0]))
    xy = jnp.concatenate([own_xy, parked_xy])
    mask = jnp.concatenate([others, parked], axis=1) & in_view(config, own_pose, xy)
    return nearest(own_xy, xy, mask, config.tracked_cars)


def tracks(
    config: ObservationConfig,
    own_pose: jax.Array,
    parked_xy: jax.Array,
    parked_present: jax.Array | None = None,
) -> jax.Array:
    """Whether agents track each other; arguments as those of `track_cars`.

    Returns:
        (num_agents, num_agents) bool, [i, j] whether i tracks j.
    """
    if not (config.tracked_cars or config.tracked_agents):
        return jnp.zeros((own_pose.shape[0],) * 2, bool)
    if config.encoding == "tanner":
        index, present = track_cars(config, own_pose, parked_xy, parked_present)
    else:
        index, present = track_agents(config, own_pose)
    agents = jnp.arange(own_pose.shape[0])
    return jnp.any((index[..., None] == agents) & present[..., None], axis=1)
