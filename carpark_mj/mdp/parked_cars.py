"""Which car fits where: in bays, in the bay it stands in, at a start pose."""

import jax
import jax.numpy as jnp

from carpark_mj.config import ParkedRule
from carpark_mj.geometry import box_disc_overlap, boxes_overlap, to_world
from carpark_mj.layouts.types import Layout

# Least room beyond the car, along and across, that makes a bay a goal [m]: under
# `strict` the footprint must end within the lines, which takes some room to steer; the
# other rules judge the centre, so that a car need only not be larger than its bay.
SLACK: dict[ParkedRule, float] = {"strict": 0.1, "precise": 0.0, "tanner": 0.0}

AWAY = 1e4  # m; parked cars that are absent stand so far out, one behind the other
_QUEUE = 20.0  # m between them


def fits(bay_size: jax.Array, car_size: jax.Array, slack: float = 0.0) -> jax.Array:
    """Whether cars (..., 2) fit into bays (bays, 2), with room to spare [m].

    Returns:
        (..., bays) bool.
    """
    return jnp.all(car_size[..., None, :] + slack <= bay_size, axis=-1)


def stand_in_bay(
    bay_pose: jax.Array, bay_size: jax.Array, size: jax.Array, offset: jax.Array
) -> jax.Array:
    """Poses (..., 3) of cars that stand off the middle of their bays.

    A car that fits into its bay stays within the lines: first its heading is cut to
    what the lines allow, then its place. One that does not fit stands in the middle.

    Args:
        bay_pose: (..., 3).
        bay_size: (..., 2) [m].
        size: (..., 2) footprints of the cars [m].
        offset: (..., 3) wanted place and heading in the bay's frame [m, m, rad].
    """
    # Turned by h, a box reaches r cos(h - phi) along and r sin(h + phi) across, with
    # its diagonal r and phi = atan(width / length).
    diagonal = jnp.linalg.norm(size, axis=-1)
    phi = jnp.arctan2(size[..., 1], size[..., 0])
    along, across = bay_size[..., 0] / diagonal, bay_size[..., 1] / diagonal
    free = jnp.pi / 2
    most = jnp.minimum(
        jnp.where(along < 1.0, phi - jnp.arccos(jnp.minimum(along, 1.0)), free),
        jnp.where(across < 1.0, jnp.arcsin(jnp.minimum(across, 1.0)) - phi, free),
    )
    most = jnp.maximum(most, 0.0)
    yaw = jnp.clip(offset[..., 2], -most, most)
    cos, sin = jnp.cos(yaw), jnp.abs(jnp.sin(yaw))
    reach = jnp.stack(
        [
            size[..., 0] * cos + size[..., 1] * sin,
            size[..., 0] * sin + size[..., 1] * cos,
        ],
        axis=-1,
    )
    room = jnp.maximum(bay_size - reach, 0.0) / 2
    xy = jnp.clip(offset[..., :2], -room, room)
    return to_world(bay_pose, jnp.concatenate([xy, yaw[..., None]], axis=-1))


def parked_poses(
    layout: Layout,
    parked_bay: jax.Array,
    parked_size: jax.Array,
    offset: jax.Array | None,
) -> jax.Array:
    """Poses (num_parked_cars, 3) of parked cars, `AWAY` of those that are absent.

    Args:
        layout: the lot.
        parked_bay: (num_parked_cars,) bays, see `goals.Occupancy`.
        parked_size: (num_parked_cars, 2) [m].
        offset: (num_parked_cars, 3) see `stand_in_bay`; None = all in the middle.
    """
    pose = layout.bay_pose[parked_bay]
    if offset is not None:
        pose = stand_in_bay(pose, layout.bay_size[parked_bay], parked_size, offset)
    place = AWAY + _QUEUE * jnp.arange(parked_bay.shape[0], dtype=pose.dtype)
    zero = jnp.zeros_like(place)
    away = jnp.stack([place, zero, zero], axis=-1)
    return jnp.where((parked_bay < layout.num_bays)[:, None], pose, away)


def touches(
    layout: Layout,
    pose: jax.Array,
    size: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
) -> jax.Array:
    """Whether one car at poses (n, 3) would touch a wall, a disc or a parked car.

    Args:
        layout: the lot.
        pose: (n, 3) of the footprint's centre.
        size: (2,) [m].
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].

    Returns:
        (n,) bool.
    """
    own = pose[:, None]
    walls = boxes_overlap(own, size, layout.wall_pose, layout.wall_size)
    discs = box_disc_overlap(own, size, layout.disc_centre, layout.disc_radius)
    parked = boxes_overlap(own, size, parked_pose, parked_size)
    return (
        (walls & layout.wall_mask).any(1)
        | (discs & layout.disc_mask).any(1)
        | parked.any(1)
    )
