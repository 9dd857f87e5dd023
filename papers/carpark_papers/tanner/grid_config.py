"""The back end `grid`: the grid world of Tanner 2022 (arXiv 2206.13338)."""

import dataclasses
import math
import pkgutil
from typing import Any

import numpy as np

from carpark_mj.config import PHYSICS, WORLD_UNIT, EnvConfig, PhysicsConfig
from carpark_mj.config.checks import require_whole


@dataclasses.dataclass(frozen=True)
class GridConfig(PhysicsConfig):
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
        back_end: fixed.
    """

    points: int = 16
    speed_step: int = 4
    headings: int = 24
    max_forward: int = 4
    max_reverse: int = 2
    max_acceleration: int = 2
    max_turn: int = 3
    turn_at_rest: bool = False
    back_end: str = "grid"
    continuous = 0
    steers = False
    actuated = False
    randomized = False

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = {f.name for f in dataclasses.fields(self)} - {
            "turn_at_rest",
            "back_end",
        }
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

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> Any:
        """Builds it; one step takes the control period."""
        del layout, vehicle
        # By its name, as its module imports this one.
        make = pkgutil.resolve_name("carpark_papers.tanner.grid:GridPhysics")
        return make(self, config.sim)

    def turn(self, before: Any, after: Any, ctrl_dt: float) -> Any:
        """Change of heading."""
        del before
        return abs(after.yaw_rate) * ctrl_dt

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> float:
        """That of the sharpest turn."""
        del vehicle, ctrl_dt
        return self.max_turn * 2 * math.pi / self.headings

    def yaw_rate_step(self, ctrl_dt: float) -> np.float32:
        """The yaw rate of a turn by one heading [rad/s]."""
        return np.float32(2 * math.pi / self.headings / ctrl_dt)

    def top_yaw_rate(self, ctrl_dt: float) -> float:
        """That of the sharpest turn."""
        return float(self.max_turn * self.yaw_rate_step(ctrl_dt))

    def top_speed(self, vehicle: Any, ctrl_dt: float) -> float:
        """That of the highest level."""
        del vehicle
        level = self.speed_step * self.point_size / ctrl_dt
        return level * max(self.max_forward, self.max_reverse)


FINE = GridConfig()  # of the study's PPO
# Of its Q-learning, table C.1, and of the runs of figure 5.1 as they were recorded.
COARSE = GridConfig(
    points=1,
    speed_step=1,
    headings=8,
    max_forward=1,
    max_reverse=1,
    max_acceleration=1,
    max_turn=1,
)
RECORDED = dataclasses.replace(COARSE, turn_at_rest=True)


def grid_scale(config: EnvConfig) -> GridConfig:
    """The grid whose levels and headings are observed: the fine one for other cars."""
    physics = config.physics_config
    return physics if isinstance(physics, GridConfig) else FINE


PHYSICS.register("grid", FINE)
PHYSICS.register("grid_coarse", COARSE)
PHYSICS.register("grid_recorded", RECORDED)
