"""Errors of what agents observe of the cars' motion."""

import dataclasses

from carpark_mj.config.checks import CheckedConfig, require_at_least, require_whole


@dataclasses.dataclass(frozen=True)
class SensorConfig(CheckedConfig):
    """Errors of what agents observe of the cars' motion; none by default.

    Attributes:
        position_noise: standard deviation of the white noise on x and y [m].
        heading_noise: standard deviation of the white noise on the yaw [rad].
        speed_noise: standard deviation of the white noise on the velocity, forward and
            left [m/s].
        delay_min: shortest delay of a car's measurements [control steps].
        delay_max: longest delay [control steps]; the delay is drawn at every spawn.
    """

    position_noise: float = 0.0
    heading_noise: float = 0.0
    speed_noise: float = 0.0
    delay_min: int = 0
    delay_max: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_at_least(self, 0.0, "position_noise", "heading_noise", "speed_noise")
        require_whole(self, 0, "delay_min")
        require_whole(self, self.delay_min, "delay_max")

    @property
    def is_on(self) -> bool:
        """Whether observations differ from the true motion."""
        return self != SensorConfig()
