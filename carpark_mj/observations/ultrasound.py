"""Ultrasound: the distances to what stands in the cones of twelve sensors.

The nearest point of a convex shape within a cone is the shape's nearest point, or else
lies on an edge of the cone, so the distance is exact for boxes and discs.
"""

import math

import jax
import jax.numpy as jnp

from carpark_mj.config import UltrasoundConfig
from carpark_mj.geometry import rotate
from carpark_mj.geometry.obstacles import Boxes, Group
from carpark_mj.geometry.se2 import norm
from carpark_mj.observations.fields import Field
from carpark_mj.observations.parts import Part, Sight

ULTRASOUND = "ultrasound"  # name of the field
_NOISE = 0x55535544  # tells its random numbers from the others of a lot's key
# Half lengths ahead, half widths to the left, and yaw of the axis [deg]: four in each
# bumper and two on each side, as in a car that parks itself.
_FRONT = ((1.0, 0.9, 40.0), (1.0, 0.35, 5.0), (1.0, -0.35, -5.0), (1.0, -0.9, -40.0))
_SIDES = ((0.85, 1.0, 90.0), (-0.85, 1.0, 90.0))
SENSORS = (
    *_FRONT,
    *((-x, -y, yaw + 180.0) for x, y, yaw in _FRONT),
    *_SIDES,
    *((x, -y, -yaw) for x, y, yaw in _SIDES),
)


def ultrasound_part(config: UltrasoundConfig) -> Part:
    """The field `ultrasound`."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        distance = echo_distances(config, sight)
        if config.noise:
            key = jax.random.fold_in(sight.state.key, _NOISE)
            noise = config.noise * jax.random.normal(key, distance.shape)
            heard = distance < config.reach
            distance = jnp.where(heard, distance + noise, distance)
        distance = jnp.clip(distance, config.dead_zone, config.reach)
        return {ULTRASOUND: distance / config.reach}

    meaning = (
        "distance in the cones of the sensors: front and rear bumper, left and right "
        f"side [{config.reach:g} m]"
    )
    return Part((Field(ULTRASOUND, len(SENSORS), 0.0, 1.0, meaning),), fill)


def echo_distances(config: UltrasoundConfig, sight: Sight) -> jax.Array:
    """Distances (num_observers, 12) [m] without noise; at most the reach."""
    motion = sight.motion
    x, y, yaw = jnp.array(SENSORS).T
    half = motion.size[:, None] / 2
    own_yaw = motion.pose_w[:, None, 2]
    mount = rotate(half * jnp.stack([x, y], axis=-1), own_yaw)
    origin = motion.xy[:, None] + mount  # (agents, sensors, 2)
    axis = own_yaw + jnp.radians(yaw)
    nearest = jnp.full(axis.shape, config.reach)
    for group in sight.obstacles:
        if group.count:
            found = _echoes(group, origin[:, None], axis[:, None], config.cone / 2)
            counts = group.counts(axis.shape[0])[..., None]
            found = jnp.where(counts, found, jnp.inf)
            nearest = jnp.minimum(nearest, jnp.min(found, axis=1))
    return nearest


def _echoes(
    group: Group, origin: jax.Array, axis: jax.Array, spread: float
) -> jax.Array:
    """Distances (agents, n, sensors) [m] to each of a group within cones.

    Args:
        group: n obstacles.
        origin: (agents, 1, sensors, 2) apexes of the cones [m].
        axis: (agents, 1, sensors) directions of their axes [rad].
        spread: half the angle of a cone [rad].
    """
    offset = origin - group.pose_w[:, None, :2]
    if type(group) is Boxes:
        yaw = group.pose_w[:, None, 2]
        local = rotate(offset, -yaw)
        half = group.size[:, None] / 2
        way = rotate(jnp.clip(local, -half, half) - local, yaw)
        distance = norm(way)
    else:
        way, distance = -offset, jnp.maximum(norm(offset) - group.size[:, None], 0.0)
    ahead = way[..., 0] * jnp.cos(axis) + way[..., 1] * jnp.sin(axis)
    inside = ahead >= norm(way) * math.cos(spread)
    least = jnp.where(inside, distance, jnp.inf)
    for edge in (axis - spread, axis + spread):
        direction = jnp.stack([jnp.cos(edge), jnp.sin(edge)], axis=-1)
        least = jnp.minimum(least, group.ray_distance(origin, direction))
    return least
