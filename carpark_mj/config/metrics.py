"""Measurements of an episode: how one is declared, and the optional ones."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

from carpark_mj.config.checks import LARGEST, CheckedConfig, require_name
from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.extensions import Registry

# How episodes add up.
Pool = Literal["rate", "mean", "parked", "steps", "episodes", "least", "most"]
# Of metrics that are numbers of every step: how their names begin, which says how they
# are folded (`carpark_mj.mdp.metrics.tallies`), and the value that episodes begin with.
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
        study: its name in tables C.3 and C.4 of Tanner 2022.
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
    study: str = ""
    ratio: tuple[str, str] | None = None
    value: Callable[..., Any] | None = None
    kind: ObstacleKind | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.value is None:
            return
        require_name("pool of a metric with a value", self.pool, _FOLDS)
        start, _ = _FOLDS[self.pool]
        found = next(
            (x for x in ("min_", "peak_", "last_") if self.name.startswith(x)), ""
        )
        if found != start:
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
    """Makes a metric known by its name.

    Raises:
        ValueError: the name is taken, or the metric has no value.
    """
    if metric.value is None:
        raise ValueError(f"metric {metric.name!r} needs a value, its number of a step")
    METRICS.register(metric.name, metric)


@dataclasses.dataclass(frozen=True)
class MetricsConfig(CheckedConfig):
    """Optional measurements, which cost time in every step; see `docs/metrics.md`.

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
    def everything(cls) -> "MetricsConfig":
        """All there is to measure."""
        return cls(driving=True, safety=True, extra=tuple(METRICS))
