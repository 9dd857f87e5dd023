"""Clearance: the gap from each agent's footprint to what it could hit."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_disc_distance, box_distance
from carpark_mj.geometry.broad_phase import (
    box_gaps,
    disc_gaps,
    least_near,
    reaches,
    strays,
)
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion

RANGE = 20.0  # m, what is farther away counts as this far: nothing is near
CHUNK = 2  # pairs per agent worked out at a time: the nearest is among the first


def clearances(
    layout: Layout,
    vehicle: Motion,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    parked_mask: jax.Array,
) -> dict[str, jax.Array]:
    """Gaps (num_agents,) [m] of the step by kind: `agent`, `parked_car`, `wall`.

    The smallest at the traced instants, those at which `episode.find_hits` looks: 0
    where footprints overlapped at one of them. At most `RANGE`. Discs count as walls.

    Args:
        layout: the lot.
        vehicle: the agents (num_agents,).
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        parked_mask: (num_parked_cars,) bool, cars that exist.
    """
    num_agents = vehicle.size.shape[0]
    others = ~jnp.eye(num_agents, dtype=bool)
    return {
        "agent": _box_clearance(
            vehicle, vehicle.trace_w, vehicle.size, strays(vehicle), others
        ),
        "parked_car": _box_clearance(
            vehicle, parked_pose[:, None], parked_size, 0.0, parked_mask
        ),
        "wall": jnp.minimum(
            _box_clearance(
                vehicle,
                layout.wall_pose[:, None],
                layout.wall_size,
                0.0,
                layout.wall_mask,
            ),
            _disc_clearance(layout, vehicle),
        ),
    }


def _box_clearance(
    vehicle: Motion,
    trace: jax.Array,
    size: jax.Array,
    stray: jax.Array | float,
    counts: jax.Array,
) -> jax.Array:
    """Gaps (num_agents,) to the nearest of n boxes.

    Args:
        vehicle: the agents.
        trace: (n, k, 3) of the boxes, k = 1 for those that stand still.
        size: (n, 2) [m].
        stray: (n,) how far they are at most from where they end [m].
        counts: (n,) or (num_agents, n) bool, boxes that exist.
    """
    own = vehicle.trace_w
    gap = box_gaps(own[:, -1, :2], trace[:, -1], size)
    bound = gap - stray - reaches(vehicle)[:, None]

    def find(index: jax.Array) -> jax.Array:
        own_size, other_size = vehicle.size[:, None, None], size[index][:, :, None]
        found = box_distance(own[:, None], own_size, trace[index], other_size)
        return jnp.min(found, axis=-1)

    return least_near(jnp.where(counts, bound, jnp.inf), find, RANGE, CHUNK)


def _disc_clearance(layout: Layout, vehicle: Motion) -> jax.Array:
    """Gaps (num_agents,) to the nearest disc."""
    own, centre, radius = vehicle.trace_w, layout.disc_centre, layout.disc_radius
    gap = disc_gaps(own[:, -1, :2], centre, radius)
    bound = gap - reaches(vehicle)[:, None]

    def find(index: jax.Array) -> jax.Array:
        where, reach = centre[index][:, :, None], radius[index][:, :, None]
        found = box_disc_distance(
            own[:, None], vehicle.size[:, None, None], where, reach
        )
        return jnp.min(found, axis=-1)

    return least_near(jnp.where(layout.disc_mask, bound, jnp.inf), find, RANGE, CHUNK)
