"""Tallies: numbers of every step, folded into one per episode by name.

The name says how: `min_...` keeps the least, `peak_...` the largest, `last_...` the
latest (memory for the next step, not reported), and every other is a sum. Ratios are
left to who reads the episodes, so that numerators and denominators add up exactly over
episodes and agents; `catalogue` says which belong together. To add a tally, give its
first value in `first_tallies` and its value of a step in `measure`.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import MetricsConfig
from carpark_mj.geometry import rotate
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.metrics.clearance import RANGE, clearances
from carpark_mj.mdp.metrics.collision_time import HORIZON, collision_times
from carpark_mj.types import Motion

KINDS = ("agent", "parked_car", "wall")  # what an agent can hit
_DRIVING = (
    "speed_sum",
    "yaw_rate_sum",
    "steering_rate_sum",
    "goal_steps",
    "towards_goal_steps",
    "nearest_car_sum",
    "nearest_car_steps",
)
_SAFETY = (
    "acceleration_sum",
    "jerk_sum",
    "peak_acceleration",
    "peak_jerk",
    "last_acceleration_x",
    "last_acceleration_y",
)


def first_tallies(config: MetricsConfig, num_agents: int) -> dict[str, jax.Array]:
    """Tallies (num_agents,) float32 at the start of an episode; cars stand still."""
    first: dict[str, float] = {}
    if config.driving:
        first |= dict.fromkeys(_DRIVING, 0.0)
    if config.safety:
        first |= dict.fromkeys(_SAFETY, 0.0)
        first |= {f"min_clearance_{kind}": RANGE for kind in KINDS}
        first |= {f"min_collision_time_{kind}": HORIZON for kind in KINDS}
    return {
        name: jnp.full(num_agents, value, jnp.float32) for name, value in first.items()
    }


def fold_tallies(
    tallies: dict[str, jax.Array], step: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """Tallies (num_agents,) with a step's numbers of the same names folded in."""

    def fold(name: str) -> jax.Array:
        old, new = tallies[name], step[name].astype(jnp.float32)
        if name.startswith("min_"):
            return jnp.minimum(old, new)
        if name.startswith("peak_"):
            return jnp.maximum(old, new)
        return new if name.startswith("last_") else old + new

    return {name: fold(name) for name in tallies}


def measure(
    config: MetricsConfig,
    ctrl_dt: float,
    layout: Layout,
    tallies: dict[str, jax.Array],
    before: Motion,
    after: Motion,
    goal_pose: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    parked_mask: jax.Array,
    has_goal: jax.Array | bool = True,
) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of one step, by the names of `first_tallies`.

    Args:
        config: what to measure.
        ctrl_dt: control period [s].
        layout: the lot.
        tallies: of the episodes so far.
        before: the agents (num_agents,) at the start of the step.
        after: at its end, before any respawn.
        goal_pose: (num_agents, 3) goals held during the step.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        parked_mask: (num_parked_cars,) bool, cars that exist.
        has_goal: (num_agents,) bool, agents that had a goal.
    """
    step: dict[str, jax.Array] = {}
    if config.driving:
        step |= _driving(ctrl_dt, before, after, goal_pose, has_goal)
        step |= _nearest_car(after, parked_pose, parked_mask)
    if config.safety:
        step |= _smoothness(ctrl_dt, tallies, before, after)
        parked = parked_pose, parked_size, parked_mask
        gap = clearances(layout, after, *parked)
        time = collision_times(layout, after, *parked)
        step |= {f"min_clearance_{kind}": gap[kind] for kind in KINDS}
        step |= {f"min_collision_time_{kind}": time[kind] for kind in KINDS}
    return step


def _driving(
    ctrl_dt: float,
    before: Motion,
    after: Motion,
    goal_pose: jax.Array,
    has_goal: jax.Array | bool,
) -> dict[str, jax.Array]:
    """Speeds at the end of the step, and whether it led nearer to the goal."""

    def distance(vehicle: Motion) -> jax.Array:
        return jnp.linalg.norm(vehicle.pose_w[..., :2] - goal_pose[..., :2], axis=-1)

    has_goal = jnp.broadcast_to(has_goal, after.speed.shape)
    return {
        "speed_sum": jnp.abs(after.speed),
        "yaw_rate_sum": jnp.abs(after.yaw_rate),
        "steering_rate_sum": jnp.abs(after.steering - before.steering) / ctrl_dt,
        "goal_steps": has_goal,
        "towards_goal_steps": has_goal & (distance(after) < distance(before)),
    }


def _nearest_car(
    vehicle: Motion, parked_pose: jax.Array, parked_mask: jax.Array
) -> dict[str, jax.Array]:
    """Distance to the nearest centre of another agent or parked car, if any."""
    own = vehicle.pose_w[:, :2]
    other = jnp.concatenate([own, parked_pose[:, :2]])
    others = ~jnp.eye(own.shape[0], other.shape[0], dtype=bool)
    mask = others & jnp.concatenate([jnp.ones(own.shape[0], bool), parked_mask])
    distance = jnp.linalg.norm(own[:, None] - other, axis=-1)
    nearest = jnp.min(jnp.where(mask, distance, jnp.inf), axis=1)
    present = jnp.isfinite(nearest)
    return {
        "nearest_car_sum": jnp.where(present, nearest, 0.0),
        "nearest_car_steps": present,
    }


def _smoothness(
    ctrl_dt: float,
    tallies: dict[str, jax.Array],
    before: Motion,
    after: Motion,
) -> dict[str, jax.Array]:
    """Acceleration and jerk of the rear axle: differences over control steps.

    Both are vectors in the plane, so that turning counts as braking does; cars spawn
    at rest and unaccelerated.
    """

    def velocity(vehicle: Motion) -> jax.Array:
        return rotate(vehicle.velocity_b, vehicle.pose_w[..., 2])

    x, y = jnp.moveaxis((velocity(after) - velocity(before)) / ctrl_dt, -1, 0)
    acceleration = jnp.hypot(x, y)
    jerk = jnp.hypot(
        x - tallies["last_acceleration_x"], y - tallies["last_acceleration_y"]
    )
    jerk = jerk / ctrl_dt
    return {
        "acceleration_sum": acceleration,
        "peak_acceleration": acceleration,
        "jerk_sum": jerk,
        "peak_jerk": jerk,
        "last_acceleration_x": x,
        "last_acceleration_y": y,
    }
