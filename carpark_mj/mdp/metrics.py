"""Metrics of episodes, kept per agent in the state.

Most are *tallies*: numbers of every step, folded into one per episode. The name selects
the fold: `min_...` keeps the least, `peak_...` the largest, `last_...` the latest
(memory for the next step, not reported); any other name is a sum. Ratios are computed
later, so that numerators and denominators add up exactly over episodes and agents;
`carpark_mj.evaluation.catalogue` pairs them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import LARGEST, CheckedConfig, require_name
from carpark_mj.extensions import Registry
from carpark_mj.geometry import heading_error, norm
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.collisions import first_safety, measure_safety
from carpark_mj.mdp.goals import CONTEXTS
from carpark_mj.mdp.progress import direction_of_travel, is_nearer
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.obstacles import hit_kinds
from carpark_mj.types import NO_BAY, EpisodeStats, State, Transition

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

# How episodes add up.
Pool = Literal["rate", "mean", "parked", "steps", "episodes", "least", "most"]
# Of metrics that are numbers of every step: how their names begin, which says how they
# are folded, and the value that episodes begin with.
_FOLDS: dict[str, tuple[str, float]] = {
    "mean": ("", 0.0),
    "steps": ("", 0.0),
    "least": ("min_", LARGEST),
    "most": ("peak_", -LARGEST),
}


@dataclasses.dataclass(frozen=True)
class Metric(CheckedConfig):
    """A metric of an episode.

    Attributes:
        name: column of the table of episodes.
        unit: unit of the column; empty for counts, flags and shares.
        meaning: its definition.
        pool: how episodes are aggregated, a key of `evaluation.catalogue.POOLS`.
        ratio: numerator and denominator columns; None if it is not a ratio.
        value: its number of a step, a function of an `EnvConfig` and a `Transition`
            that returns (num_agents,), in JAX; `transition.before.stats` has what is
            known of the episode so far. By `pool` an episode has their sum (`mean`),
            their mean (`steps`), the least (`least`, its name begins with `min_`) or
            the largest (`most`, `peak_`). None for the library's own, which are
            measured together.
        kind: of the obstacles that it is about; lots that never have such obstacles
            do not measure it. None = any lot does.
    """

    name: str
    unit: str
    meaning: str
    pool: Pool
    ratio: tuple[str, str] | None = None
    value: Callable[..., jax.Array] | None = None
    kind: ObstacleKind | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.value is None:
            return
        require_name("pool of a metric with a value", self.pool, _FOLDS)
        start, _ = _FOLDS[self.pool]
        prefixes = (x for x in ("min_", "peak_", "last_") if self.name.startswith(x))
        if next(prefixes, "") != start:
            raise ValueError(
                f"the name of a metric of pool {self.pool!r} must begin with "
                f"{start or 'no min_, peak_ or last_'}, not be {self.name!r}"
            )
        if self.pool == "steps":
            object.__setattr__(self, "ratio", (f"{self.name}_sum", "length"))

    @property
    def tally(self) -> str:
        """Name of the number that is carried through an episode."""
        return f"{self.name}_sum" if self.pool == "steps" else self.name

    @property
    def first(self) -> float:
        """Its value at the start of an episode."""
        return _FOLDS[self.pool][1]


# Metrics beyond those of `carpark_mj.evaluation.catalogue`, for `MetricsConfig.extra`.
METRICS: Registry[Metric] = Registry("metric", "carpark_mj.mdp.people")


def register_metric(metric: Metric) -> None:
    """Makes a metric known by its name; `ValueError` if taken, or without a value."""
    if metric.value is None:
        raise ValueError(f"metric {metric.name!r} needs a value, its number of a step")
    METRICS.register(metric.name, metric)


@dataclasses.dataclass(frozen=True)
class MetricsConfig(CheckedConfig):
    """Optional measurements, which cost time in every step.

    The outcome, return, length, path and final errors are always measured. Evaluation
    enables all of these, training none by default.

    Attributes:
        driving: measure speed, turning, the nearest car, and steps towards the goal.
        safety: measure clearance, time to collision, acceleration and jerk.
        extra: measure registered metrics, by name.
    """

    driving: bool = False
    safety: bool = False
    extra: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.extra:
            METRICS[name]  # refuses unknown ones

    @classmethod
    def everything(cls) -> MetricsConfig:
        """All registered metrics."""
        return cls(driving=True, safety=True, extra=tuple(METRICS))


def init_stats(config: EnvConfig, layout: Layout) -> EpisodeStats:
    """Statistics of all agents of a lot at the start of their episodes."""
    first = {f"return_{name}": 0.0 for name in term_weights(config)}
    if config.goals.dynamic:
        first |= dict.fromkeys(COUNTS, 0.0)
    if config.metrics.driving:
        first |= dict.fromkeys(SUMS, 0.0)
    if config.metrics.safety:
        first |= first_safety(hit_kinds(config.movers))
    for metric in _registered(config):
        if metric.tally in first:
            raise ValueError(f"there is a metric {metric.tally!r} already")
        first[metric.tally] = metric.first
    count = config.num_agents
    zero = jnp.zeros(count, jnp.float32)
    return EpisodeStats(
        episode_return=zero,
        length=zero,
        path=zero,
        gear_changes=zero,
        direction=zero,
        invalid_actions=zero,
        wrong_way=zero if layout.has_lanes else None,
        tallies={k: jnp.full(count, x, jnp.float32) for k, x in first.items()},
    )


def update_stats(
    config: EnvConfig, transition: Transition, terms: dict[str, jax.Array]
) -> EpisodeStats:
    """Adds a step, with its reward by term, for agents that were active in it."""
    before, motion = transition.before, transition.after.motion
    old = before.stats
    points = [before.motion.pose_w[..., None, :2], motion.trace_w[..., :2]]
    points = jnp.concatenate(points, axis=-2)  # driven along
    path = norm(jnp.diff(points, axis=-2)).sum(axis=-1)
    wrong_way = None
    if old.wrong_way is not None and transition.wrong_way is not None:
        wrong_way = old.wrong_way + path * transition.wrong_way
    step = {f"return_{name}": term for name, term in terms.items()}
    if transition.goal_events is not None:
        step |= count_goals(transition)
    if config.metrics.driving:
        step |= measure_driving(config.sim.ctrl_dt, transition)
    if config.metrics.safety:
        step |= measure_safety(config.sim.ctrl_dt, transition)
    for metric in _registered(config):
        assert metric.value is not None
        step[metric.tally] = metric.value(config, transition)
    if only := old.tallies.keys() ^ step.keys():
        raise ValueError(f"{sorted(only)} are not both tallies and numbers of the step")
    tallies: dict[str, jax.Array] = {}
    for name, tally in old.tallies.items():
        number = step[name].astype(jnp.float32)
        if name.startswith("min_"):
            number = jnp.minimum(tally, number)
        elif name.startswith("peak_"):
            number = jnp.maximum(tally, number)
        elif not name.startswith("last_"):
            number = tally + number
        tallies[name] = number
    direction = direction_of_travel(motion)
    new = EpisodeStats(
        episode_return=old.episode_return + jnp.sum(jnp.stack([*terms.values()]), 0),
        length=old.length + 1.0,
        path=old.path + path,
        gear_changes=old.gear_changes + (direction * old.direction < 0),
        direction=jnp.where(direction != 0, direction, old.direction),
        invalid_actions=old.invalid_actions + transition.invalid_action,
        wrong_way=wrong_way,
        tallies=tallies,
    )
    return jax.tree.map(lambda x, y: jnp.where(before.active, x, y), new, old)


def episode_metrics(
    transition: Transition, stats: EpisodeStats
) -> dict[str, jax.Array]:
    """Named metrics (num_agents,) float32 of episodes, valid where `events.done`."""
    pose_w, target = transition.after.motion.pose_w, transition.target_pose
    turned = pose_w[..., 2] - target[..., 2]
    counts = ("episode_return", "length", "path", "gear_changes", "invalid_actions")
    metrics = {
        **{name: x for name, x in vars(transition.events).items() if x is not None},
        **{name: getattr(stats, name) for name in counts},
        "final_distance": norm(pose_w[..., :2] - target[..., :2]),
        "final_heading": heading_error(turned, transition.one_way),
        "final_speed": jnp.abs(transition.after.motion.speed),
    }
    if stats.wrong_way is not None:
        metrics["wrong_way"] = stats.wrong_way
    for name, tally in stats.tallies.items():
        if name in metrics:
            raise ValueError(f"there is a metric {name!r} already")
        if not name.startswith("last_"):
            metrics[name] = tally
    return {name: value.astype(jnp.float32) for name, value in metrics.items()}


def _registered(config: EnvConfig) -> list[Metric]:
    """Metrics of `MetricsConfig.extra` whose obstacles the lots may have."""
    found = [METRICS[name] for name in config.metrics.extra]
    return [x for x in found if x.kind in {None, *hit_kinds(config.movers)}]


SUMS = (
    *("speed_sum", "yaw_rate_sum", "steering_rate_sum"),
    *("goal_steps", "towards_goal_steps", "nearest_car_sum", "nearest_car_steps"),
)


def measure_driving(ctrl_dt: float, transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step by the names of `SUMS`, at its end."""
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
    known = jnp.isfinite(nearest)
    nearest = jnp.where(known, nearest, 0.0)
    return {"nearest_car_sum": nearest, "nearest_car_steps": known}


CHANGES = ("stop_explore", "change_goal", "stop_goal", "lost_untracked", "lost_taken")
COUNTS = (
    "explored_steps",
    "towards_bay_steps",
    *CHANGES,
    *(f"met_{name}" for name in CONTEXTS),
    *(f"gave_way_{name}" for name in CONTEXTS),
)


def count_goals(transition: Transition) -> dict[str, jax.Array]:
    """The numbers (num_agents,) of a step with dynamic goals by the names of `COUNTS`.

    `met_<context>` is 1 in the context, `gave_way_<context>` if the agent also chose
    another goal or to explore; losing a goal does not count as giving way.
    """
    before, after = transition.before, transition.after
    events = transition.goal_events
    assert events is not None
    assert before.tracked_bays is not None
    bay_xy = before.layout.bay_pose[before.tracked_bays, :2]
    nearer = is_nearer(before.motion.xy[:, None], after.motion.xy[:, None], bay_xy)
    towards_bay = (nearer & (before.tracked_bays != NO_BAY)).any(axis=1)
    gave_up = events.change_goal | events.stop_goal
    return {
        "explored_steps": events.exploring,
        "towards_bay_steps": events.exploring & towards_bay,
        **{name: getattr(events, name) for name in CHANGES},
        **{f"met_{name}": met for name, met in events.contexts.items()},
        **{f"gave_way_{name}": met & gave_up for name, met in events.contexts.items()},
    }
