"""Settings of the curricula: what training does that evaluation never does."""

import dataclasses

from carpark_mj.config.checks import CheckedConfig, require_at_least, require_ratio


@dataclasses.dataclass(frozen=True)
class CurriculumConfig(CheckedConfig):
    """Curricula of a PPO training, all off by default.

    Progress is the share of the training that is over.

    Attributes:
        crash_scale: factor on the crash penalty that is reached, linearly from 1, at
            progress `crash_until`. A hard penalty from the start teaches halting.
        crash_until: progress at which the crash penalty has its full size.
        discount_end: discount factor at the end; 0 = that of the start. In between
            1 / (1 - discount), the horizon, changes linearly.
        discount_from: progress at which the discount begins to change.
        discount_until: progress at which it has reached `discount_end`.
        crash_ratio: share of spawns on course for a collision; 0 = as in the
            environment.
        reverse_ratio: share of spawns where a car has got to that drove out of the goal
            bay; 0 = as in the environment.
        target_rate: rate of parked episodes by whose shortfall half of a mixture's new
            lots are drawn (`lot_life`); 0 = all are drawn as the mixture says.
    """

    crash_scale: float = 1.0
    crash_until: float = 0.7
    discount_end: float = 0.0
    discount_from: float = 0.3
    discount_until: float = 0.8
    crash_ratio: float = 0.0
    reverse_ratio: float = 0.0
    target_rate: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_least(self, 0.0, "crash_scale")
        require_ratio(
            self, "crash_until", "discount_from", "discount_until", "crash_ratio"
        )
        require_ratio(self, "reverse_ratio", "target_rate")
        if not 0.0 <= self.discount_end < 1.0:
            raise ValueError(
                f"discount_end must lie in [0, 1), not {self.discount_end}"
            )
        if self.discount_from > self.discount_until:
            raise ValueError(
                f"discount_from {self.discount_from} must not exceed discount_until "
                f"{self.discount_until}"
            )
