"""The four scenarios of Cederle 2023 as data.

Offsets are metres from the start of a lane; a goal beyond its end is its end.
"""

import dataclasses
import itertools

from carpark_papers.cederle.junction.roads import LANES, path_length
from carpark_papers.cederle.junction.routes import Route


@dataclasses.dataclass(frozen=True)
class Mission:
    """Start and destination of an automated car.

    Attributes:
        route: the lanes.
        start: offset in the first lane [m].
        goal: offset in the last lane [m].
    """

    route: Route
    start: float
    goal: float

    def __post_init__(self) -> None:
        lane = path_length(LANES[self.route.start])
        if not 0.0 <= self.start <= lane:
            raise ValueError(
                f"start of a mission must lie in [0, {lane:.2f}] m on lane "
                f"{self.route.start!r}, not {self.start}"
            )

    @property
    def goal_along(self) -> float:
        """Distance of the goal along the route [m]."""
        goal = min(self.goal, path_length(LANES[self.route.end]))
        return self.route.curve[1] + goal

    @property
    def length(self) -> float:
        """Way from start to goal [m]."""
        return self.goal_along - self.start


@dataclasses.dataclass(frozen=True)
class HumanCar:
    """A human-driven car: it keeps its lane and ignores all others.

    Attributes:
        route: the lanes; it leaves at the end of the last one.
        start: offset in the first lane [m].
        speed: at the start [m/s].
    """

    route: Route
    start: float
    speed: float = 10.0


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Missions and human-driven cars.

    Attributes:
        missions: of the automated cars.
        human_cars: the others.
        solved: return of all agents together from which the study calls it solved.
    """

    missions: tuple[Mission, ...]
    human_cars: tuple[HumanCar, ...]
    solved: float

    @property
    def queues(self) -> list[tuple[Mission, Mission | HumanCar, int]]:
        """Pairs of cars that start on one lane, and how many of them are automated."""
        pairs = [(a, b, 2) for a, b in itertools.combinations(self.missions, 2)]
        pairs += [(a, b, 1) for a in self.missions for b in self.human_cars]
        return [pair for pair in pairs if pair[0].route.start == pair[1].route.start]


_LEFT_FROM_EAST = Route("east-EW", "south-NS")
_LEFT_FROM_SOUTH = Route("south-SN", "west-EW")
_STRAIGHT_FROM_WEST = Route("west-WE", "east-WE")

SCENARIOS: dict[str, Scenario] = {
    "2av": Scenario(
        missions=(
            Mission(_LEFT_FROM_EAST, 20.0, 30.0),
            Mission(_STRAIGHT_FROM_WEST, 10.0, 30.0),
        ),
        human_cars=(),
        solved=100.0,
    ),
    # Where the human-driven car turns is not published (SMARTS draws the route of an
    # endless mission): to the left, across everybody's way. Right does not fit the
    # first points of the study's curves, see docs/junction.md.
    "2av-hd": Scenario(
        missions=(
            Mission(_LEFT_FROM_EAST, 10.0, 60.0),
            Mission(_STRAIGHT_FROM_WEST, 10.0, 60.0),
        ),
        human_cars=(HumanCar(_LEFT_FROM_SOUTH, 10.0),),
        solved=100.0,
    ),
    "3av": Scenario(
        missions=(
            Mission(_LEFT_FROM_EAST, 15.0, 30.0),
            Mission(_LEFT_FROM_SOUTH, 15.0, 30.0),
            Mission(_STRAIGHT_FROM_WEST, 15.0, 30.0),
        ),
        human_cars=(),
        solved=120.0,
    ),
    "3av-hd": Scenario(
        missions=(
            Mission(_LEFT_FROM_EAST, 10.0, 30.0),
            Mission(_LEFT_FROM_SOUTH, 10.0, 30.0),
            Mission(_STRAIGHT_FROM_WEST, 10.0, 30.0),
        ),
        human_cars=(HumanCar(_LEFT_FROM_SOUTH, 20.0),),
        solved=120.0,
    ),
}


def scenario(name: str) -> Scenario:
    """Looks a scenario up.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}; choose from {sorted(SCENARIOS)}")
    return SCENARIOS[name]
