"""The observation of Tanner 2022's Q-learning: a few whole numbers, to index a table.

Own level of speed, counted from the fastest reverse; the bearing of the goal's centre,
clockwise from the own heading, to the nearest of the grid's headings; and for every
ring how many objects touch it, capped. Objects are whole walls, discs and, with
`ObservationConfig.ring_cars`, parked cars and other agents. The k-th ring has the k-th
diameter: his program, by a slip, gave it the one before.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import GridConfig, ObservationConfig
from carpark_mj.geometry import point_box_distance, to_local
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import make_fields
from carpark_mj.types import VehicleState


def observe_indices(
    config: ObservationConfig,
    grid: GridConfig,
    ctrl_dt: float,
    layout: Layout,
    vehicle: VehicleState,
    goal: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
) -> jax.Array:
    """Observations of all agents of a lot.

    Args:
        config: rings.
        grid: granularities.
        ctrl_dt: control period [s].
        layout: the lot.
        vehicle: the agents (num_agents,).
        goal: (num_agents,) bay indices.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].

    Returns:
        (num_agents, 2 + rings) float32 whole numbers, the fields of `make_fields`.
    """
    per_level = grid.speed_step * grid.point_size / ctrl_dt  # m/s
    level = jnp.round(vehicle.speed / per_level) + grid.max_reverse
    local = to_local(vehicle.pose_w, layout.bay_pose[goal])
    clockwise = -jnp.arctan2(local[:, 1], local[:, 0])
    bearing = jnp.round(clockwise * grid.headings / (2 * jnp.pi))
    values = [level[:, None], jnp.mod(bearing, grid.headings)[:, None]]
    if config.rings:
        values.append(_count(config, layout, vehicle, parked_pose, parked_size))
    return jnp.concatenate(values, axis=-1).astype(jnp.float32)


def _count(
    config: ObservationConfig,
    layout: Layout,
    vehicle: VehicleState,
    parked_pose: jax.Array,
    parked_size: jax.Array,
) -> jax.Array:
    """Capped counts (num_agents, rings) of the objects that touch each ring."""
    xy = vehicle.pose_w[:, None, :2]
    walls = point_box_distance(xy, layout.wall_pose, layout.wall_size)
    discs = jnp.linalg.norm(xy - layout.disc_centre, axis=-1) - layout.disc_radius
    gaps = [
        jnp.where(layout.wall_mask, walls, jnp.inf),
        jnp.where(layout.disc_mask, discs, jnp.inf),
    ]
    if config.ring_cars:
        own = jnp.eye(xy.shape[0], dtype=bool)
        agents = point_box_distance(xy, vehicle.pose_w, vehicle.size)
        gaps.append(jnp.where(own, jnp.inf, agents))
        gaps.append(point_box_distance(xy, parked_pose, parked_size))
    gap = jnp.concatenate(gaps, axis=-1)
    radii = jnp.array(config.rings, gap.dtype) / 2
    count = jnp.sum(gap[..., None] < radii, axis=1)
    return jnp.minimum(count, config.ring_cap)


def cardinalities(config: ObservationConfig, grid: GridConfig) -> tuple[int, ...]:
    """How many values each number of the observation can have."""
    return tuple(int(field.high) + 1 for field in make_fields(config, grid))
