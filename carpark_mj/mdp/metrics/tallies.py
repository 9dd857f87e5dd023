"""Tallies: numbers of every step, folded into one per episode.

The name selects the fold: `min_...` keeps the least, `peak_...` the largest, `last_...`
the latest (memory for the next step, not reported); any other name is a sum. Ratios are
computed later, so that numerators and denominators add up exactly over episodes and
agents; `carpark_mj.evaluation.catalogue` pairs them. Each registered metric has one.
"""

from typing import get_args

import jax
import jax.numpy as jnp

from carpark_mj.config import METRICS, ContextName, EnvConfig, Metric
from carpark_mj.config.obstacles import hit_kinds
from carpark_mj.geometry import norm
from carpark_mj.mdp.metrics import safety
from carpark_mj.mdp.progress import is_nearer
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.types import NO_BAY, GoalEvents, State, Transition


def first_tallies(config: EnvConfig) -> dict[str, jax.Array]:
    """Tallies (num_agents,) float32 at the start of an episode.

    Raises:
        ValueError: two metrics have the same name.
    """
    first = {f"return_{name}": 0.0 for name in term_weights(config)}
    if config.goals.dynamic:
        first |= dict.fromkeys(COUNTS, 0.0)
    if config.metrics.driving:
        first |= dict.fromkeys(SUMS, 0.0)
    if config.metrics.safety:
        first |= safety.first_safety(hit_kinds(config.movers))
    for metric in _extra(config):
        if metric.tally in first:
            raise ValueError(f"there is a metric {metric.tally!r} already")
        first[metric.tally] = metric.first
    return {
        name: jnp.full(config.num_agents, value, jnp.float32)
        for name, value in first.items()
    }


def measure(
    config: EnvConfig, transition: Transition, terms: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of one step, by the names of `first_tallies`.

    Args:
        config: says what to measure.
        transition: the step.
        terms: (num_agents,) its reward by term.
    """
    step = {f"return_{name}": term for name, term in terms.items()}
    if transition.goal_events is not None:
        step |= count_goals(transition.goal_events, transition)
    if config.metrics.driving:
        step |= measure_driving(config.sim.ctrl_dt, transition)
    if config.metrics.safety:
        step |= safety.measure_safety(config.sim.ctrl_dt, transition)
    for metric in _extra(config):
        assert metric.value is not None
        step[metric.tally] = metric.value(config, transition)
    return step


def _extra(config: EnvConfig) -> list[Metric]:
    kinds = {None, *hit_kinds(config.movers)}
    found = [METRICS[name] for name in config.metrics.extra]
    return [metric for metric in found if metric.kind in kinds]


def fold_tallies(
    tallies: dict[str, jax.Array], step: dict[str, jax.Array]
) -> dict[str, jax.Array]:
    """Tallies (num_agents,) with a step's numbers of the same names folded in.

    Raises:
        ValueError: a name is only among the tallies or only in the step.
    """
    if tallies.keys() != step.keys():
        raise ValueError(
            "tallies and numbers of a step must have the same names, but "
            f"{sorted(tallies.keys() - step.keys())} are only tallies and "
            f"{sorted(step.keys() - tallies.keys())} only numbers of the step"
        )

    def fold(name: str) -> jax.Array:
        old, new = tallies[name], step[name].astype(jnp.float32)
        if name.startswith("min_"):
            return jnp.minimum(old, new)
        if name.startswith("peak_"):
            return jnp.maximum(old, new)
        return new if name.startswith("last_") else old + new

    return {name: fold(name) for name in tallies}


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


CONTEXTS: tuple[ContextName, ...] = get_args(ContextName)
CHANGES = ("stop_explore", "change_goal", "stop_goal", "lost_untracked", "lost_taken")
COUNTS = (
    "explored_steps",
    "towards_bay_steps",
    *CHANGES,
    *(f"met_{name}" for name in CONTEXTS),
    *(f"gave_way_{name}" for name in CONTEXTS),
)


def count_goals(events: GoalEvents, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `COUNTS`.

    `met_<context>` is 1 in the context, `gave_way_<context>` if the agent also chose
    another goal or to explore; losing a goal does not count as giving way.
    """
    gave_up = events.change_goal | events.stop_goal
    counts = {
        "explored_steps": events.exploring,
        "towards_bay_steps": events.exploring & is_nearer_to_any(transition),
        **{name: getattr(events, name) for name in CHANGES},
    }
    met = {f"met_{name}": events.contexts[name] for name in CONTEXTS}
    gave_way = {
        f"gave_way_{name}": events.contexts[name] & gave_up for name in CONTEXTS
    }
    return counts | met | gave_way


def is_nearer_to_any(transition: Transition) -> jax.Array:
    """Whether the step led agents (num_agents,) nearer to a bay tracked at its start.

    Raises:
        ValueError: goals are fixed, so that no bays are tracked.
    """
    before, after = transition.before, transition.after
    if before.tracked_bays is None:
        raise ValueError("agents track bays only where they choose their goals")
    bay_xy = before.layout.bay_pose[before.tracked_bays, :2]
    nearer = is_nearer(before.motion.xy[:, None], after.motion.xy[:, None], bay_xy)
    return (nearer & (before.tracked_bays != NO_BAY)).any(axis=1)
