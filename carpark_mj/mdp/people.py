"""How agents treat people: terms of the reward, and metrics.

A near miss is a time to collision with a person below 1.5 s, the threshold of serious
encounters in van der Horst 1990 ("A time-based analysis of road user behaviour"), or a
gap below 0.5 m at more than 1 m/s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from carpark_mj.geometry.obstacles import Group, ObstacleKind
from carpark_mj.mdp.collisions import HORIZON, RANGE, collision_times
from carpark_mj.mdp.metrics import Metric, Pool, register_metric
from carpark_mj.mdp.rewards import REWARD_TERMS, RewardTerm
from carpark_mj.types import State, Transition

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

PERSON = ObstacleKind.PERSON
CLOSE_TIME = 1.5  # s, of a near miss
CLOSE, FAST = 0.5, 1.0  # m and m/s, of a near miss
COMFORT = 2.0  # m, gap within which a person minds the speed of a car [est]
HARD_BRAKING = 4.0  # m/s²
STANDS = 0.1  # m/s, speed below which a car stands [est]
WAITS_FOR = 8.0  # m, gap to a person that a standing car may wait for [est]


def _people(state: State) -> list[Group]:
    return [group for group in state.movers.groups if group.kind == PERSON]


def _gap(state: State) -> jax.Array:
    """Gaps (num_agents,) [m] to the nearest person as they stand, at most `RANGE`."""
    motion, gap = state.motion, jnp.full(state.goal.shape, RANGE)
    for group in _people(state):
        found = group.distance(motion.pose_w[:, None], motion.size[:, None])
        counts = group.counts(gap.shape[0])
        gap = jnp.minimum(gap, jnp.where(counts, found, RANGE).min(axis=1))
    return gap


def _speed(state: State) -> jax.Array:
    return jnp.abs(state.motion.speed)


def person(_: EnvConfig, transition: Transition) -> jax.Array:
    """Penalty for a contact with a person, in addition to that of the crash."""
    hit = transition.events.hit_person
    return jnp.zeros(transition.goal.shape) if hit is None else hit.astype(jnp.float32)


def comfort(_: EnvConfig, transition: Transition) -> jax.Array:
    """Penalty per step for passing people fast: (share of 2 m missing, times m/s)².

    The square makes passing slowly cheaper than passing fast, which takes fewer steps.
    """
    near = jnp.maximum(1.0 - _gap(transition.after) / COMFORT, 0.0)
    return jnp.square(near * _speed(transition.after))


REWARD_TERMS.register("person", RewardTerm(person, sign=-1))
REWARD_TERMS.register("comfort", RewardTerm(comfort, sign=-1, per_step=True))


def _is_near_miss(state: State) -> jax.Array:
    times = collision_times(state.motion, _people(state))
    soon = times.get(PERSON.label, jnp.full(state.goal.shape, HORIZON)) < CLOSE_TIME
    return soon | ((_gap(state) < CLOSE) & (_speed(state) > FAST))


def near_misses(_: EnvConfig, transition: Transition) -> jax.Array:
    """1 in the step in which a near miss begins."""
    began = _is_near_miss(transition.after) & ~_is_near_miss(transition.before)
    return began.astype(jnp.float32)


def speed_at_least_gap(config: EnvConfig, transition: Transition) -> jax.Array:
    """Changes of a sum that is the own speed where a person has been nearest."""
    if "min_person_gap" not in config.metrics.extra:
        raise ValueError("person_speed needs min_person_gap in metrics.extra too")
    tallies, gap = transition.before.stats.tallies, _gap(transition.after)
    change = _speed(transition.after) - tallies["person_speed"]
    return jnp.where(gap < tallies["min_person_gap"], change, 0.0)


def contact_speed(config: EnvConfig, transition: Transition) -> jax.Array:
    """Own speed at a contact with a person, before the step in which it happened."""
    speed = jnp.maximum(_speed(transition.before), _speed(transition.after))
    return person(config, transition) * speed


def hard_braking(config: EnvConfig, transition: Transition) -> jax.Array:
    """1 in steps in which the speed fell by more than `HARD_BRAKING` per second."""
    lost = _speed(transition.before) - _speed(transition.after)
    return (lost > HARD_BRAKING * config.sim.ctrl_dt).astype(jnp.float32)


def waiting(config: EnvConfig, transition: Transition) -> jax.Array:
    """Time [s] in which the car stands while a person is near."""
    stands = _speed(transition.after) < STANDS
    near = _gap(transition.after) < WAITS_FOR
    return (stands & near) * config.sim.ctrl_dt


_MISSES = (
    f"near misses: time to collision with a person below {CLOSE_TIME:g} s, or a gap "
    f"below {CLOSE:g} m at more than {FAST:g} m/s"
)
_LEAST_GAP = f"smallest gap to a person at the ends of steps; capped at {RANGE:g} m"
_CONTACT = "own speed at a contact with a person; 0 without one"
_BRAKING = f"steps that brake by more than {HARD_BRAKING:g} m/s²"
_WAITING = f"time standing with a person within {WAITS_FOR:g} m"
_METRICS: tuple[tuple[str, str, Pool, Callable[..., jax.Array], str], ...] = (
    ("near_misses", "", "mean", near_misses, _MISSES),
    ("min_person_gap", "m", "least", lambda _, step: _gap(step.after), _LEAST_GAP),
    ("person_speed", "m/s", "mean", speed_at_least_gap, "own speed at that gap"),
    ("peak_contact_speed", "m/s", "most", contact_speed, _CONTACT),
    ("hard_braking", "steps", "mean", hard_braking, _BRAKING),
    ("waiting", "s", "mean", waiting, _WAITING),
)
for _name, _unit, _pool, _value, _meaning in _METRICS:
    register_metric(Metric(_name, _unit, _meaning, _pool, value=_value, kind=PERSON))
