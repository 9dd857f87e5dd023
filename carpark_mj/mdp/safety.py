"""How safely agents drive: gaps, times to collision, acceleration and jerk."""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_distance, norm, point_box_distance, rotate
from carpark_mj.geometry.obstacles import (
    MARGIN,
    Group,
    ObstacleKind,
    is_crowded,
    least_near,
    take,
)
from carpark_mj.geometry.se2 import with_gradient
from carpark_mj.mdp.collisions import trace_radius
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import Motion, Transition

RANGE = 20.0  # m, largest clearance reported
HORIZON = 10.0  # s, longest time to collision reported
CHUNK = 2  # pairs per agent computed at a time: the nearest is among the first


def agent_clearance(motion: Motion) -> jax.Array:
    """Gap (num_agents,) [m] to the nearest other agent, as they stand; inf if alone."""
    num_agents = motion.size.shape[0]
    crowded = is_crowded(num_agents, num_agents)
    find = _near_agent_gap if crowded else _agent_gap
    return find(motion.pose_w, motion.size)


def _agent_gap(pose: jax.Array, size: jax.Array) -> jax.Array:
    """`agent_clearance` from all pairs."""
    own = jnp.eye(pose.shape[0], dtype=bool)
    gap = box_distance(pose[:, None], size[:, None], pose, size)
    return jnp.min(jnp.where(own, jnp.inf, gap), axis=0)


@functools.partial(with_gradient, like=_agent_gap)
def _near_agent_gap(pose: jax.Array, size: jax.Array) -> jax.Array:
    """`agent_clearance` from near pairs."""
    own = jnp.eye(pose.shape[0], dtype=bool)

    def find(index: jax.Array) -> jax.Array:
        return box_distance(pose[:, None], size[:, None], pose[index], size[index])

    reach = norm(size) / 2
    bound = point_box_distance(pose[:, None, :2], pose, size) - reach[:, None]
    return least_near(jnp.where(own, jnp.inf, bound), find, jnp.inf, CHUNK)


def _least_by_kind(
    obstacles: Sequence[Group], find: Callable[[Group], jax.Array]
) -> dict[str, jax.Array]:
    """The least of the numbers (num_agents,) of groups, by the kinds' labels."""
    least: dict[str, jax.Array] = {}
    for group in obstacles:
        label, found = group.kind.label, find(group)
        least[label] = jnp.minimum(least[label], found) if label in least else found
    return least


def clearances(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Gaps (num_agents,) [m] of the step by the labels of `ObstacleKind`.

    The smallest gap at the traced instants, where collisions are tested: 0 if
    footprints overlapped at one of them. At most `RANGE`.
    """

    def clearance(group: Group) -> jax.Array:
        own, traced = motion.trace_w, group.traced
        bound = group.gaps(own[:, -1, :2]) - group.excursion
        bound = bound - trace_radius(motion)[:, None]

        def find(index: jax.Array) -> jax.Array:
            own_size = motion.size[:, None, None]
            return take(traced, index).distance(own[:, None], own_size).min(axis=-1)

        counts = group.counts(motion.size.shape[0])
        return least_near(jnp.where(counts, bound, jnp.inf), find, RANGE, CHUNK)

    return _least_by_kind(obstacles, clearance)


def collision_times(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Times to collision (num_agents,) [s] by the labels of `ObstacleKind`.

    0 where footprints overlap, at most `HORIZON`. The definition is Hayward's (1972,
    "Near-miss determination through use of a scale of danger"): the time until two cars
    collide "if they continue at their present speed and on the same path". Here every
    car continues in the plane with the velocity of its rear axle and its present
    heading, and footprints are boxes. Turning is ignored, so a car that steers clear of
    a wall has a finite time to it.
    """
    pose, size = motion.pose_w[:, None], motion.size[:, None]
    own = rotate(motion.velocity_b, motion.pose_w[..., 2])[:, None]

    def contact_time(group: Group) -> jax.Array:
        gap = group.gaps(motion.pose_w[:, :2])
        relative = own if group.velocity_w is None else own - group.velocity_w

        def find(index: jax.Array) -> jax.Array:
            near = take(group, index)
            towards = own if near.velocity_w is None else own - near.velocity_w
            return near.contact_time(pose, size, towards)

        # Lower bounds: the gap of the circle about the car over the relative speed,
        # inf where they keep their distance.
        free = gap - norm(motion.size)[:, None] / 2 - MARGIN
        bound = jnp.where(free > 0.0, free / norm(relative), 0.0)
        counts = group.counts(motion.size.shape[0])
        return least_near(jnp.where(counts, bound, jnp.inf), find, HORIZON, CHUNK)

    return _least_by_kind(obstacles, contact_time)


def first_safety(kinds: Sequence[ObstacleKind]) -> dict[str, float]:
    """Names, and values at the start of an episode, of what agents can hit."""
    labels = [kind.label for kind in kinds]
    return {
        "acceleration_sum": 0.0,
        "jerk_sum": 0.0,
        "peak_acceleration": 0.0,
        "peak_jerk": 0.0,
        "last_acceleration_x": 0.0,
        "last_acceleration_y": 0.0,
        **{f"min_clearance_{label}": RANGE for label in labels},
        **{f"min_collision_time_{label}": HORIZON for label in labels},
    }


def measure_safety(ctrl_dt: float, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `first_safety`."""
    after = transition.after
    motion = after.motion
    there = lot_obstacles(after.layout, motion, after.parked_cars, after.movers)
    gaps, times = clearances(motion, there), collision_times(motion, there)
    return {
        **_smoothness(ctrl_dt, transition),
        **{f"min_clearance_{kind}": gap for kind, gap in gaps.items()},
        **{f"min_collision_time_{kind}": time for kind, time in times.items()},
    }


def _smoothness(ctrl_dt: float, transition: Transition) -> dict[str, jax.Array]:
    """Acceleration and jerk of the rear axle: differences over control steps.

    Both are vectors in the plane, so lateral acceleration counts as braking does.
    """

    def velocity_w(motion: Motion) -> jax.Array:
        return rotate(motion.velocity_b, motion.pose_w[..., 2])

    gained = velocity_w(transition.after.motion) - velocity_w(transition.before.motion)
    x, y = jnp.moveaxis(gained / ctrl_dt, -1, 0)
    last = transition.before.stats.tallies
    acceleration = jnp.hypot(x, y)
    jerk = jnp.hypot(x - last["last_acceleration_x"], y - last["last_acceleration_y"])
    jerk = jerk / ctrl_dt
    return {
        "acceleration_sum": acceleration,
        "peak_acceleration": acceleration,
        "jerk_sum": jerk,
        "peak_jerk": jerk,
        "last_acceleration_x": x,
        "last_acceleration_y": y,
    }
