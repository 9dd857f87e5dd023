"""Granularities of the grid world of Tanner 2022 (arXiv 2206.13338)."""

import dataclasses

from carpark_mj.config.checks import CheckedConfig, require_whole

WORLD_UNIT = 0.5625  # m; Tanner's car of 8 world units is then 4.5 m long


@dataclasses.dataclass(frozen=True)
class GridConfig(CheckedConfig):
    """The velocity motion model on a grid; the defaults are those of the study's PPO.

    Attributes:
        points: grid points per world unit, 0.5625 m: the study's position granularity
            squared. Its text has 2 to its power instead, which contradicts the 74 x 74
            points it counts for a granularity of 1.
        speed_step: points per step that one level of speed moves (G_v).
        headings: equally spaced headings, the first along +y (G_theta).
        max_forward: highest level of speed forwards.
        max_reverse: highest level of speed in reverse.
        max_acceleration: most levels of speed by which one action changes the speed.
        max_turn: most headings by which one action turns the car.
        turn_at_rest: whether a car at standstill turns, too.
    """

    points: int = 16
    speed_step: int = 4
    headings: int = 24
    max_forward: int = 4
    max_reverse: int = 2
    max_acceleration: int = 2
    max_turn: int = 3
    turn_at_rest: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = {f.name for f in dataclasses.fields(self)} - {"turn_at_rest"}
        require_whole(self, 1, *sorted(numbers))
        if 2 * self.max_turn >= self.headings:
            raise ValueError(
                f"max_turn must be less than half of {self.headings} headings, not "
                f"{self.max_turn}"
            )

    @property
    def point_size(self) -> float:
        """Distance of neighbouring points [m]."""
        return WORLD_UNIT / self.points

    @property
    def num_levels(self) -> int:
        """Levels of speed, standing still included."""
        return self.max_reverse + 1 + self.max_forward

    @property
    def choices(self) -> tuple[int, int]:
        """Numbers of accelerations and of turns to choose from."""
        return 2 * self.max_acceleration + 1, 2 * self.max_turn + 1
