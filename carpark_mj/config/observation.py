"""What agents see."""

import dataclasses
import math
from typing import Literal

from carpark_mj.config.checks import at_least, choose, positive
from carpark_mj.config.grid import WORLD_UNIT

Encoding = Literal["continuous", "tanner", "indices"]
BayPart = Literal["heading", "distance", "bearing"]
BAY_PARTS: tuple[BayPart, ...] = ("heading", "distance", "bearing")


@dataclasses.dataclass(frozen=True)
class ObservationConfig:
    """What an agent sees; the fields are listed in `carpark_mj.observations.fields`.

    Attributes:
        tracked_agents: nearest agents seen.
        tracked_parked_cars: nearest parked cars seen.
        rings: diameters [m] of the circles about the car in which walls and discs are
            counted.
        ring_cap: largest count a ring reports.
        own_car: see the own size, axles and turning radius; always so where agents are
            drawn from a fleet.
        rays: bearings along which the free way is seen, evenly spaced about the car
            from straight ahead; 0 = none. Field `rays`, one number each: from the car's
            outline to the nearest wall, disc, parked car or other agent.
        ray_range: longest way seen along a ray [m].
        lane: see the lane the car is in, or the nearest. Fields `lane_present`,
            `lane_heading` (cos and sin, body frame) and `lane_one_way`.
        encoding: `continuous`; `tanner`: the study's vector,
            `carpark_mj.observations.tanner`; or `indices`: whole numbers for a table,
            as in its Q-learning on the grid, `carpark_mj.observations.indices`.
        ring_cars: rings count parked cars and other agents too.
        ring_history: past counts of every ring that are seen (n_h), zero before the
            episode.
        share_speeds: see the speeds of tracked agents.
        share_goals: see the goals of tracked agents: where they are or, where agents
            choose them, which of the observer's tracked bays.
        share_goal_heading: see the headings of their goals too; fixed goals only.
        global_information: see, of the goal or of every tracked bay, how near the
            nearest of all agents is, and the nearest that has it as goal.
        field_of_view: full angle about the own heading [deg] in which other cars and
            free bays are tracked.
        tracking_diameter: of the circle about the car in which they are [m]; None = the
            whole lot.
        tracked_cars: with `tanner`, nearest cars seen, agents and parked cars in one
            list (n_track).
        bay_parts: with `tanner`, what is seen of the goal, or of tracked bays.
    """

    tracked_agents: int = 2
    tracked_parked_cars: int = 2
    rings: tuple[float, ...] = (5.0, 6.2, 8.0)
    ring_cap: int = 2
    own_car: bool = False
    rays: int = 0
    ray_range: float = 10.0
    lane: bool = False
    encoding: Encoding = "continuous"
    ring_cars: bool = False
    ring_history: int = 0
    share_speeds: bool = True
    share_goals: bool = True
    share_goal_heading: bool = False
    global_information: bool = False
    field_of_view: float = 360.0
    tracking_diameter: float | None = None
    tracked_cars: int = 0
    bay_parts: tuple[BayPart, ...] = BAY_PARTS

    def __post_init__(self) -> None:
        choose("encoding", self.encoding, Encoding)
        counts = ("tracked_agents", "tracked_parked_cars", "tracked_cars")
        at_least(self, 0, *counts, "rays", "ring_history")
        positive(self, "ray_range")
        at_least(self, 1, "ring_cap")
        if any(not d > 0 for d in self.rings):
            raise ValueError(f"rings must be positive diameters, not {self.rings}")
        if len({f"{d:g}" for d in self.rings}) < len(self.rings):  # the fields' names
            raise ValueError(f"rings must be different diameters, not {self.rings}")
        if self.ring_history and not self.rings:
            raise ValueError(f"ring_history {self.ring_history} needs rings")
        if not 0.0 < self.field_of_view <= 360.0:
            raise ValueError(
                f"field_of_view must lie in (0, 360] deg, not {self.field_of_view}"
            )
        diameter = self.tracking_diameter
        if diameter is not None and not (math.isfinite(diameter) and diameter > 0):
            raise ValueError(
                f"tracking_diameter must be positive or None, not {diameter}"
            )
        if self.share_goal_heading and not self.share_goals:
            raise ValueError("share_goal_heading needs share_goals")
        for part in self.bay_parts:
            choose("bay part", part, BayPart)
        if len(set(self.bay_parts)) < len(self.bay_parts):
            raise ValueError(f"bay_parts must be different, not {self.bay_parts}")
        if self.encoding == "continuous":
            self._require_defaults("tracked_cars", "bay_parts")
            return
        if self.tracked_agents or self.tracked_parked_cars:
            kind = "cars in one list" if self.encoding == "tanner" else "no cars"
            raise ValueError(
                f"encoding '{self.encoding}' tracks {kind}: tracked_agents and "
                "tracked_parked_cars must be 0, not "
                f"{self.tracked_agents} and {self.tracked_parked_cars}"
            )
        self._require_defaults("rays", "lane")
        if self.encoding == "indices":
            self._require_defaults("tracked_cars", "bay_parts", "global_information")

    def _require_defaults(self, *names: str) -> None:
        """Refuses settings that the encoding does not have."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name in names and value != field.default:
                raise ValueError(
                    f"encoding '{self.encoding}' has no {field.name}: it must be "
                    f"{field.default}, not {value}"
                )


# What the agents of the study's PPO see, tables C.9 and C.10: 11 numbers.
TANNER_OBSERVATION = ObservationConfig(
    tracked_agents=0,
    tracked_parked_cars=0,
    tracked_cars=1,
    rings=(11 * WORLD_UNIT,),
    ring_cap=1,
    encoding="tanner",
)
