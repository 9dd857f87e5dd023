"""The observation of Tanner 2022's Q-learning: a few whole numbers, to index a table.

Own level of speed, counted from the fastest reverse; the bearing of the goal's centre,
clockwise from the own heading, to the nearest of the grid's headings; and for every
ring how many objects touch it, capped, now and `ring_history` steps before. The k-th
ring has the k-th diameter: his program, by a slip, gave it the one before.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import GridConfig, ObservationConfig
from carpark_mj.geometry import to_local
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import make_fields
from carpark_mj.observations.rings import count_rings, ring_counts
from carpark_mj.observations.tanner import bearing_index, speed_level
from carpark_mj.types import Motion


def observe_indices(
    config: ObservationConfig,
    grid: GridConfig,
    ctrl_dt: float,
    layout: Layout,
    vehicle: Motion,
    goal: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    ring_history: jax.Array | None = None,
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
        ring_history: see `rings.init_history`.

    Returns:
        (num_agents, observation_size) float32 whole numbers, the fields of
        `make_fields`.
    """
    level = jnp.round(speed_level(grid, ctrl_dt, vehicle.speed)) + grid.max_reverse
    bearing = bearing_index(grid, to_local(vehicle.pose_w, layout.bay_pose[goal]))
    values = [level[:, None], bearing[:, None]]
    if config.rings:
        now = count_rings(config, layout, vehicle, parked_pose, parked_size)
        values += ring_counts(config, now, ring_history).values()
    return jnp.concatenate(values, axis=-1).astype(jnp.float32)


def cardinalities(config: ObservationConfig, grid: GridConfig) -> tuple[int, ...]:
    """How many values each number of the observation can have."""
    return tuple(int(field.high) + 1 for field in make_fields(config, grid))
