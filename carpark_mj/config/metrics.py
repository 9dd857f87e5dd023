"""Optional measurements of an episode."""

import dataclasses

from carpark_mj.config.checks import CheckedConfig


@dataclasses.dataclass(frozen=True)
class MetricsConfig(CheckedConfig):
    """Optional measurements, which cost time in every step; see `docs/metrics.md`.

    The outcome, return, length, path and final errors are always measured. Evaluation
    enables all of these, training none by default.

    Attributes:
        driving: measure speed, turning, the nearest car, and steps towards the goal.
        safety: measure clearance, time to collision, acceleration and jerk.
    """

    driving: bool = False
    safety: bool = False
