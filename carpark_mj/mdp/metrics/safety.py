"""How safely and smoothly agents drive."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import rotate
from carpark_mj.mdp.clearance import KINDS, RANGE, clearances
from carpark_mj.mdp.metrics.collision_time import HORIZON, collision_times
from carpark_mj.types import Motion, Transition

# Names, and values at the start of an episode: at rest, unaccelerated, nothing near.
FIRST = {
    "acceleration_sum": 0.0,
    "jerk_sum": 0.0,
    "peak_acceleration": 0.0,
    "peak_jerk": 0.0,
    "last_acceleration_x": 0.0,
    "last_acceleration_y": 0.0,
    **{f"min_clearance_{kind}": RANGE for kind in KINDS},
    **{f"min_collision_time_{kind}": HORIZON for kind in KINDS},
}


def measure_safety(ctrl_dt: float, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `FIRST`.

    Args:
        ctrl_dt: control period [s].
        transition: the step.
    """
    after = transition.after
    where = after.layout, after.motion, after.parked_cars
    gap, time = clearances(*where), collision_times(*where)
    return {
        **_smoothness(ctrl_dt, transition),
        **{f"min_clearance_{kind}": gap[kind] for kind in KINDS},
        **{f"min_collision_time_{kind}": time[kind] for kind in KINDS},
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
