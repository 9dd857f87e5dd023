"""What agents observe: one config per encoding of the observation vector."""

import dataclasses
import math
from typing import Literal

from carpark_mj.config.checks import (
    CheckedConfig,
    require_positive,
    require_whole,
)
from carpark_mj.config.units import WORLD_UNIT

BayPart = Literal["heading", "distance", "bearing"]
BAY_PARTS: tuple[BayPart, ...] = ("heading", "distance", "bearing")


@dataclasses.dataclass(frozen=True)
class RingConfig(CheckedConfig):
    """Circles about the car that count the objects they touch; none by default.

    Attributes:
        diameters: diameters of the circles [m].
        cap: largest count a ring reports.
        cars: also count parked cars and other agents, not only walls and discs.
        history: number of past counts of every ring that are observed (n_h); zero
            before the episode.
    """

    diameters: tuple[float, ...] = ()
    cap: int = 2
    cars: bool = False
    history: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(not (math.isfinite(d) and d > 0) for d in self.diameters):
            raise ValueError(f"ring diameters must be positive, not {self.diameters}")
        if len({f"{d:g}" for d in self.diameters}) < len(self.diameters):
            # Fields are named by the diameters.
            raise ValueError(f"ring diameters must be different, not {self.diameters}")
        require_whole(self, 1, "cap")
        require_whole(self, 0, "history")
        if self.history and not self.diameters:
            raise ValueError(f"ring history {self.history} needs ring diameters")


@dataclasses.dataclass(frozen=True)
class ViewConfig(CheckedConfig):
    """Where other cars and free bays are tracked; in the whole lot by default.

    Attributes:
        field_of_view: full angle of view about the own heading [deg].
        diameter: diameter of the circle about the car that is in view [m]; None = the
            whole lot.
    """

    field_of_view: float = 360.0
    diameter: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.field_of_view <= 360.0:
            raise ValueError(
                f"field_of_view must lie in (0, 360] deg, not {self.field_of_view}"
            )
        diameter = self.diameter
        if diameter is not None and not (math.isfinite(diameter) and diameter > 0):
            raise ValueError(f"view diameter must be positive or None, not {diameter}")

    @property
    def is_limited(self) -> bool:
        """Whether anything in the lot can be out of view."""
        return self != ViewConfig()


@dataclasses.dataclass(frozen=True)
class ShareConfig(CheckedConfig):
    """What agents observe of the other agents they track, in addition to their poses.

    Attributes:
        speeds: observe the speeds of tracked agents.
        goals: observe the goals of tracked agents: positions of fixed goals, and which
            of the observer's tracked bays a dynamic goal is.
        goal_headings: also observe the headings of their goals; fixed goals only.
        steering: observe the steering of tracked agents.
        order: observe which tracked agents come before the own car in the lot's order,
            so that two agents of the same policy that meet can act differently.
    """

    speeds: bool = True
    goals: bool = True
    goal_headings: bool = False
    steering: bool = False
    order: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.goal_headings and not self.goals:
            raise ValueError("share.goal_headings needs share.goals")


@dataclasses.dataclass(frozen=True)
class RayConfig(CheckedConfig):
    """Bearings along which the free way is observed; none by default.

    Attributes:
        count: number of rays, evenly spaced about the car from straight ahead; 0 =
            none. Each measures the distance from the car's outline to the nearest wall,
            disc, parked car or agent.
        reach: longest distance measured [m].
    """

    count: int = 0
    reach: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 0, "count")
        require_positive(self, "reach")


@dataclasses.dataclass(frozen=True)
class ContinuousObservation(CheckedConfig):
    """Real numbers of order 1, listed in `carpark_mj.observations.continuous`.

    Attributes:
        tracked_agents: most nearest other agents observed; fewer in a lot of fewer.
        tracked_parked_cars: most nearest parked cars observed; fewer in a lot of fewer.
        view: region in which cars and free bays are tracked.
        share: what is observed of tracked agents in addition to their poses.
        global_information: observe, for the goal or every tracked bay, the distances to
            the nearest agent and to the nearest agent that has it as its goal.
        own_car: observe the own size, axles and turning radius; required if agents are
            drawn from a fleet.
        lines: observe the room between the own outline and the goal bay's lines.
        rings: circles that count objects.
        rays: bearings along which the free way is observed.
        lane: observe the lane the car is in, or the nearest.
        route: observe the way along the lanes to the goal; fixed goals only.
        encoding: tag of this config.
    """

    tracked_agents: int = 6
    tracked_parked_cars: int = 4
    view: ViewConfig = dataclasses.field(default_factory=ViewConfig)
    share: ShareConfig = dataclasses.field(default_factory=ShareConfig)
    global_information: bool = False
    own_car: bool = False
    lines: bool = False
    rings: RingConfig = dataclasses.field(
        default_factory=lambda: RingConfig((5.0, 6.2, 8.0))
    )
    rays: RayConfig = dataclasses.field(default_factory=lambda: RayConfig(24))
    lane: bool = False
    route: bool = False
    encoding: Literal["continuous"] = "continuous"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 0, "tracked_agents", "tracked_parked_cars")


@dataclasses.dataclass(frozen=True)
class TannerObservation(CheckedConfig):
    """The vector of Tanner 2022's PPO, `carpark_mj.observations.tanner`.

    The defaults are those of tables C.9 and C.10: 11 numbers.

    Attributes:
        tracked_cars: number of nearest cars observed, agents and parked cars in one
            list (n_track); where there are fewer, the list is padded with -1.
        bay_parts: what is observed of the goal, or of every tracked bay.
        view: region in which cars and free bays are tracked.
        share: what is observed of tracked agents in addition to their poses.
        global_information: as in `ContinuousObservation`.
        rings: circles that count objects.
        encoding: tag of this config.
    """

    tracked_cars: int = 1
    bay_parts: tuple[BayPart, ...] = BAY_PARTS
    view: ViewConfig = dataclasses.field(default_factory=ViewConfig)
    share: ShareConfig = dataclasses.field(default_factory=ShareConfig)
    global_information: bool = False
    rings: RingConfig = dataclasses.field(
        default_factory=lambda: RingConfig((11 * WORLD_UNIT,), cap=1)
    )
    encoding: Literal["tanner"] = "tanner"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 0, "tracked_cars")
        if len(set(self.bay_parts)) < len(self.bay_parts):
            raise ValueError(f"bay_parts must be different, not {self.bay_parts}")
        for name in ("steering", "order"):
            if getattr(self.share, name):
                raise ValueError(f"share.{name} needs the continuous encoding")


@dataclasses.dataclass(frozen=True)
class IndexObservation(CheckedConfig):
    """Integers that index a table, as in the study's Q-learning on the grid.

    See `carpark_mj.observations.indices`. Goals must be fixed.

    Attributes:
        rings: circles that count objects.
        encoding: tag of this config.
    """

    rings: RingConfig = dataclasses.field(default_factory=RingConfig)
    encoding: Literal["indices"] = "indices"


Observation = ContinuousObservation | TannerObservation | IndexObservation
