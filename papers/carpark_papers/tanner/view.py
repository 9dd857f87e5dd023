"""Where other cars and free bays are tracked."""

import dataclasses
import math

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.geometry import nearest, norm, rotate
from carpark_mj.observations.tracking import other_agents
from carpark_mj.types import ParkedCars


@dataclasses.dataclass(frozen=True)
class ViewConfig(CheckedConfig):
    """Where other cars and free bays are tracked; in the whole lot by default.

    Attributes:
        field_of_view: full angle of view about the own heading [deg].
        diameter: diameter of the circle about the car that is in view [m]; None = the
            whole lot.
    """

    field_of_view: float = 360.0
    diameter: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.field_of_view <= 360.0:
            raise ValueError(
                f"field_of_view must lie in (0, 360] deg, not {self.field_of_view}"
            )
        diameter = self.diameter
        if diameter is not None and not (math.isfinite(diameter) and diameter > 0):
            raise ValueError(f"view diameter must be positive or None, not {diameter}")

    @property
    def is_limited(self) -> bool:
        """Whether anything in the lot can be out of view."""
        return self != ViewConfig()


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


def track_cars(
    count: int,
    view: ViewConfig,
    own_pose: jax.Array,
    parked_cars: ParkedCars,
    present: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The nearest among the other agents and parked cars together.

    Args:
        count: how many.
        view: where.
        own_pose: (num_agents, 3) observers.
        parked_cars: (num_parked_cars,) of the lot.
        present: (num_agents,) bool, see `State.present`.

    Returns:
        Indices and presence (num_agents, count), see `geometry.nearest`; indices count
        the agents first, then the parked cars.
    """
    own_xy, num_agents = own_pose[:, :2], own_pose.shape[0]
    others, parked = other_agents(num_agents, present), parked_cars.present
    parked = jnp.broadcast_to(parked, (num_agents, *parked.shape))
    xy = jnp.concatenate([own_xy, parked_cars.pose_w[:, :2]])
    mask = jnp.concatenate([others, parked], axis=1)
    return nearest(own_xy, xy, mask & in_view(view, own_pose, xy), count)
