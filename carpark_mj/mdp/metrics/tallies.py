"""Tallies: numbers of every step, folded into one per episode by name.

The name says how: `min_...` keeps the least, `peak_...` the largest, `last_...` the
latest (memory for the next step, not reported), and every other is a sum. Ratios are
computed later, so that numerators and denominators add up exactly over episodes and
agents; `carpark_mj.evaluation.catalogue` says which belong together. Metrics that other
code has registered have a tally each.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import METRICS, EnvConfig, Metric
from carpark_mj.config.obstacles import hit_kinds
from carpark_mj.mdp.metrics import driving, goals, safety
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.types import Transition


def first_tallies(config: EnvConfig) -> dict[str, jax.Array]:
    """Tallies (num_agents,) float32 at the start of an episode.

    Raises:
        ValueError: two metrics have the same name.
    """
    first = {f"return_{name}": 0.0 for name in term_weights(config)}
    if config.goals.dynamic:
        first |= dict.fromkeys(goals.COUNTS, 0.0)
    if config.metrics.driving:
        first |= dict.fromkeys(driving.SUMS, 0.0)
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
        step |= goals.count_goals(transition.goal_events, transition)
    if config.metrics.driving:
        step |= driving.measure_driving(config.sim.ctrl_dt, transition)
    if config.metrics.safety:
        step |= safety.measure_safety(config.sim.ctrl_dt, transition)
    for metric in _extra(config):
        assert metric.value is not None
        step[metric.tally] = metric.value(config, transition)
    return step


def _extra(config: EnvConfig) -> list[Metric]:
    return [METRICS[name] for name in config.metrics.extra]


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
