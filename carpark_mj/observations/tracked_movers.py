"""What agents observe of the people and other movers they track."""

import jax
import jax.numpy as jnp

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import nearest, norm, ray_box_distance, rotate
from carpark_mj.geometry.obstacles import Boxes, Group
from carpark_mj.observations.fields import (
    CAR_FIELDS,
    Field,
    localise,
    repeated,
    repeated_values,
)
from carpark_mj.observations.parts import Part, Sight

PACE = 2.0  # m/s, scale of their velocities
STANDS = 0.05  # m/s, below which a velocity has no direction
_FIELDS = (
    *CAR_FIELDS,
    Field(
        "velocity", 2, -3.0, 3.0, f"its velocity, body frame [{PACE:g} m/s]", speed=PACE
    ),
    Field("person", 1, 0.0, 1.0, "1 if it is a person, else 0"),
)


def movers_part(count: int, in_sight: bool) -> Part:
    """The nearest movers.

    Args:
        count: how many.
        in_sight: whether only those are observed whose centre can be seen from the own
            one, past other agents, parked cars and walls.
    """

    def fill(sight: Sight) -> dict[str, jax.Array]:
        own, groups = sight.motion, sight.state.movers.groups
        pose, size, velocity, there, person, round_ = _table(groups)
        mask = jnp.broadcast_to(there, (own.xy.shape[0], *there.shape))
        if in_sight:
            mask = mask & ~_hidden(sight, pose[:, :2])
        index, present = nearest(own.xy, pose[:, :2], mask, count)
        # Whoever stands without a heading is told as heading as the observer does.
        still = (norm(velocity) < STANDS) & round_
        yaw = jnp.where(still[index], own.pose_w[:, None, 2], pose[index, 2])
        seen = jnp.concatenate([pose[index, :2], yaw[..., None]], axis=-1)
        values = localise(own.pose_w, seen, size[index], present)
        way = rotate(velocity[index], -own.pose_w[:, None, 2])
        more = {"velocity": way / PACE, "person": person[index][..., None]}
        more = {k: jnp.where(present[..., None], x, 0.0) for k, x in more.items()}
        return repeated_values("mover", values | more)

    return Part(tuple(repeated("mover", count, _FIELDS)), fill)


def _table(groups: tuple[Group, ...]) -> tuple[jax.Array, ...]:
    """Poses, sizes, velocities, masks, whether they are persons and discs, (n, ...).

    The heading of a disc is that of its velocity. Without movers one is absent.
    """
    rows = []
    for group in groups:
        n, velocity, mask = group.count, group.velocity_w, group.mask
        velocity = jnp.zeros((n, 2)) if velocity is None else velocity
        pose, size = group.pose_w, group.size
        if not isinstance(group, Boxes):
            yaw = jnp.arctan2(velocity[:, 1], velocity[:, 0])
            pose = jnp.concatenate([pose, yaw[:, None]], axis=1)
            size = jnp.repeat(2.0 * size[:, None], 2, axis=1)
        there = jnp.ones(n, bool) if mask is None else mask
        person = jnp.full(n, float(group.kind == ObstacleKind.PERSON))
        disc = jnp.full(n, not isinstance(group, Boxes))
        rows.append((pose, size, velocity, there, person, disc))
    if not rows:
        nobody = jnp.zeros((1, 3)), jnp.zeros((1, 2)), jnp.zeros((1, 2))
        return *nobody, jnp.zeros(1, bool), jnp.zeros(1), jnp.zeros(1, bool)
    return tuple(jnp.concatenate(column) for column in zip(*rows, strict=True))


def _hidden(sight: Sight, xy: jax.Array) -> jax.Array:
    """(num_observers, n) bool, whether a box lies before points (n, 2)."""
    own = sight.motion.xy
    way = xy - own[:, None]
    length = norm(way)
    ahead = way / jnp.maximum(length, 1e-6)[..., None]
    movers = {id(group) for group in sight.state.movers.groups}
    hidden = jnp.zeros(length.shape, bool)
    for group in sight.obstacles:
        if isinstance(group, Boxes) and id(group) not in movers and group.count:
            found = ray_box_distance(
                own[:, None, None], ahead[:, :, None], group.pose_w, group.size
            )
            counts = group.counts(own.shape[0])[:, None]
            hidden = hidden | ((found < length[..., None]) & counts).any(axis=-1)
    return hidden
