"""How safely and smoothly agents drive."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import norm, rotate
from carpark_mj.geometry.broad_phase import MARGIN, least_near
from carpark_mj.geometry.obstacles import Group, take
from carpark_mj.mdp.clearance import RANGE, clearances, least_by_kind
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import Motion, Transition

HORIZON = 10.0  # s, longest time to collision reported
CHUNK = 2  # pairs per agent whose time to collision is computed at a time


def first_safety(kinds: Sequence[ObstacleKind]) -> dict[str, float]:
    """Names, and values at the start of an episode: at rest, no obstacle near.

    Args:
        kinds: what agents can hit.
    """
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
    """The numbers (num_agents,) of a step by the names of `first_safety`.

    Args:
        ctrl_dt: control period [s].
        transition: the step.
    """
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


def collision_times(motion: Motion, obstacles: Sequence[Group]) -> dict[str, jax.Array]:
    """Times to collision (num_agents,) [s] by the labels of `ObstacleKind`.

    0 where footprints overlap, at most `HORIZON`. The definition is Hayward's (1972,
    "Near-miss determination through use of a scale of danger"): the time until two cars
    collide "if they continue at their present speed and on the same path". Here every
    car continues in the plane with the velocity of its rear axle and its present
    heading, and footprints are boxes. Turning is ignored, so a car that steers clear of
    a wall has a finite time to it.
    """
    return least_by_kind(obstacles, lambda group: _contact_time(motion, group))


def _contact_time(motion: Motion, group: Group) -> jax.Array:
    """Times (num_agents,) to the first collision with any of a group."""
    pose, size = motion.pose_w[:, None], motion.size[:, None]
    own = rotate(motion.velocity_b, motion.pose_w[..., 2])[:, None]
    gap = group.gaps(motion.pose_w[:, :2])
    relative = own if group.velocity_w is None else own - group.velocity_w

    def find(index: jax.Array) -> jax.Array:
        near = take(group, index)
        towards = own if near.velocity_w is None else own - near.velocity_w
        return near.contact_time(pose, size, towards)

    counts = group.counts(motion.size.shape[0])
    bound = jnp.where(counts, _bound(motion, gap, relative), jnp.inf)
    return least_near(bound, find, HORIZON, CHUNK)


def _bound(motion: Motion, gap: jax.Array, relative: jax.Array) -> jax.Array:
    """Lower bounds (num_agents, n) of the times [s]: the gap over the relative speed.

    Args:
        motion: the agents.
        gap: (num_agents, n) from their centres to the others' outlines [m].
        relative: (num_agents, n or 1, 2) velocities towards them [m/s].
    """
    free = gap - norm(motion.size)[:, None] / 2 - MARGIN
    time = free / norm(relative)  # inf if they keep their distance
    return jnp.where(free > 0.0, time, 0.0)
