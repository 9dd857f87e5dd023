"""Time to collision: how soon each agent would hit something if all went straight on.

Time to collision as of Hayward 1972 ("Near-miss determination through use of a scale of
danger": the time until two cars collide "if they continue at their present speed and on
the same path"), in the plane: every car goes on with the velocity of its rear axle and
its present heading, and footprints are boxes. Cars that turn are taken to go straight
on, so a car that is steering clear of a wall has a finite time to it.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_contact_time, box_disc_contact_time, rotate
from carpark_mj.geometry.broad_phase import MARGIN, box_gaps, disc_gaps, least_near
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion

HORIZON = 10.0  # s, no collision that soon counts as this long
CHUNK = 2  # pairs per agent worked out at a time


def collision_times(
    layout: Layout,
    vehicle: Motion,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    parked_mask: jax.Array,
) -> dict[str, jax.Array]:
    """Times (num_agents,) [s] by kind: `agent`, `parked_car`, `wall`; see above.

    0 where footprints overlap, at most `HORIZON`. Discs count as walls.

    Args:
        layout: the lot.
        vehicle: the agents (num_agents,) at the instant asked about.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        parked_mask: (num_parked_cars,) bool, cars that exist.
    """
    own = jnp.eye(vehicle.size.shape[0], dtype=bool)
    velocity_w = rotate(vehicle.velocity_b, vehicle.pose_w[..., 2])

    def to_boxes(
        pose: jax.Array, size: jax.Array, velocity: jax.Array, counts: jax.Array
    ) -> jax.Array:
        relative = velocity_w[:, None] - velocity
        gap = box_gaps(vehicle.pose_w[:, :2], pose, size)

        def find(index: jax.Array) -> jax.Array:
            return box_contact_time(
                vehicle.pose_w[:, None],
                vehicle.size[:, None],
                pose[index],
                size[index],
                jnp.take_along_axis(relative, index[..., None], axis=1),
            )

        return least_near(_bound(vehicle, gap, relative, counts), find, HORIZON, CHUNK)

    def to_discs(centre: jax.Array, radius: jax.Array, counts: jax.Array) -> jax.Array:
        relative = jnp.broadcast_to(
            velocity_w[:, None], (*own.shape[:1], *centre.shape)
        )
        gap = disc_gaps(vehicle.pose_w[:, :2], centre, radius)

        def find(index: jax.Array) -> jax.Array:
            return box_disc_contact_time(
                vehicle.pose_w[:, None],
                vehicle.size[:, None],
                centre[index],
                radius[index],
                velocity_w[:, None],
            )

        return least_near(_bound(vehicle, gap, relative, counts), find, HORIZON, CHUNK)

    def at_rest(pose: jax.Array) -> jax.Array:
        return jnp.zeros_like(pose[:, :2])

    walls = to_boxes(
        layout.wall_pose, layout.wall_size, at_rest(layout.wall_pose), layout.wall_mask
    )
    discs = to_discs(layout.disc_centre, layout.disc_radius, layout.disc_mask)
    return {
        "agent": to_boxes(vehicle.pose_w, vehicle.size, velocity_w, ~own),
        "parked_car": to_boxes(
            parked_pose, parked_size, at_rest(parked_pose), parked_mask
        ),
        "wall": jnp.minimum(walls, discs),
    }


def _bound(
    vehicle: Motion, gap: jax.Array, relative: jax.Array, counts: jax.Array
) -> jax.Array:
    """No pair (num_agents, n) collides sooner [s]: the gap at the relative speed.

    Args:
        vehicle: the agents.
        gap: (num_agents, n) from their centres to the others' outlines [m].
        relative: (num_agents, n, 2) velocities towards them [m/s].
        counts: (n,) or (num_agents, n) bool, others that exist.
    """
    way = gap - jnp.linalg.norm(vehicle.size, axis=-1)[:, None] / 2 - MARGIN
    time = way / jnp.linalg.norm(relative, axis=-1)  # inf if they keep their distance
    return jnp.where(counts, jnp.where(way > 0.0, time, 0.0), jnp.inf)
