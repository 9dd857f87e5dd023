"""How agents drive: speeds, turning, the nearest car, steps towards the goal."""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm
from carpark_mj.mdp.progress import is_nearer
from carpark_mj.types import NO_BAY, State, Transition

SUMS = (
    "speed_sum",
    "yaw_rate_sum",
    "steering_rate_sum",
    "goal_steps",
    "towards_goal_steps",
    "nearest_car_sum",
    "nearest_car_steps",
)


def measure_driving(ctrl_dt: float, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `SUMS`.

    Args:
        ctrl_dt: control period [s].
        transition: the step; speeds and distances are those at its end.
    """
    before, after = transition.before.motion, transition.after.motion
    has_goal = transition.goal != NO_BAY
    nearer = is_nearer(before.xy, after.xy, transition.target_pose[:, :2])
    return {
        "speed_sum": jnp.abs(after.speed),
        "yaw_rate_sum": jnp.abs(after.yaw_rate),
        "steering_rate_sum": jnp.abs(after.steering - before.steering) / ctrl_dt,
        "goal_steps": has_goal,
        "towards_goal_steps": has_goal & nearer,
        **_nearest_car(transition.after),
    }


def _nearest_car(state: State) -> dict[str, jax.Array]:
    """Distance to the nearest centre of another agent or parked car, if any."""
    own, parked, agents = state.motion.xy, state.parked_cars, state.present
    if agents is None:
        agents = jnp.ones(own.shape[0], bool)
    other = jnp.concatenate([own, parked.pose_w[:, :2]])
    others = ~jnp.eye(own.shape[0], other.shape[0], dtype=bool)
    mask = others & jnp.concatenate([agents, parked.present])
    distance = norm(own[:, None] - other)
    nearest = jnp.min(jnp.where(mask, distance, jnp.inf), axis=1)
    is_any = jnp.isfinite(nearest)
    return {
        "nearest_car_sum": jnp.where(is_any, nearest, 0.0),
        "nearest_car_steps": is_any,
    }
