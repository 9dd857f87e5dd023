"""What is measured of an episode beside its outcome."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class MetricsConfig:
    """Measurements that cost time in every step; `docs/metrics.md` defines each.

    The outcome, return, length, path and final errors are always there. Evaluation
    takes everything, training nothing unless asked.

    Attributes:
        driving: speed, turning, the nearest car, steps towards the goal.
        safety: clearance, time to collision, acceleration and jerk.
    """

    driving: bool = False
    safety: bool = False
