"""How safely and smoothly agents drive."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import rotate
from carpark_mj.mdp.clearance import RANGE, clearances
from carpark_mj.mdp.metrics.collision_time import HORIZON, collision_times
from carpark_mj.obstacles.lot import lot_obstacles
from carpark_mj.types import Motion, Transition


def first_safety(kinds: Sequence[ObstacleKind]) -> dict[str, float]:
    """Names, and values at the start of an episode: at rest, nothing near.

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
