"""The back end `highway`: highway-env's car."""

import dataclasses
from typing import Any

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig


@dataclasses.dataclass(frozen=True)
class HighwayConfig(PhysicsConfig):
    """highway-env's car, which obeys at once and has a road's speed limits."""

    back_end: str = "highway"
    actuated = False
    randomized = False
    keeps_ranges = False

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> Any:
        """Builds it; it has no ground but a plane."""
        from carpark_papers.pandita.highway import HighwayPhysics

        del layout, vehicle
        return HighwayPhysics(config.sim)

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> Any:
        """From lock to lock."""
        del ctrl_dt
        return 2.0 * vehicle.max_steering


PHYSICS.register("highway", HighwayConfig())
