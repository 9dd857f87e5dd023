"""Scenarios and settings of the junction.

Offsets are metres from the start of a lane; a goal beyond its end is its end.
"""

import dataclasses
import itertools
from typing import Literal

from carpark_mj.config import SimConfig
from carpark_mj.config.checks import CheckedConfig, Count, NonNegative, Positive
from carpark_mj.config.vehicles import with_parameters
from carpark_papers.cederle.junction.roads import LANES, Route, path_length


@dataclasses.dataclass(frozen=True)
class Mission:
    """Start and destination of an automated car."""

    route: Route  # the lanes
    start: float  # offset in the first lane [m]
    goal: float  # offset in the last lane [m]

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
    """A human-driven car: it keeps its lane and ignores all others."""

    route: Route  # the lanes; it leaves at the end of the last one
    start: float  # offset in the first lane [m]
    speed: float = 10.0  # at the start [m/s]


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Missions and human-driven cars."""

    missions: tuple[Mission, ...]  # of the automated cars
    human_cars: tuple[HumanCar, ...]  # the others
    solved: float  # return of all agents together from which the study calls it solved

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
    """Looks a scenario up."""
    if name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}; choose from {sorted(SCENARIOS)}")
    return SCENARIOS[name]


CarModel = Literal["path", "bicycle", "mjx"]
Encoding = Literal["vector", "image"]
EventRule = Literal["added", "replaced"]
ActionKind = Literal["index", "scalar"]
EndRule = Literal["any", "all"]

QUEUE_GAP = 5.0  # m between the centres of cars on a lane; the longest has 4.90 m


@dataclasses.dataclass(frozen=True)
class RewardRules(CheckedConfig):
    """Rewards of agents, see `carpark_papers.cederle.junction.rules`.

    Attributes:
        events: `added`: the value of an event is added to that of the distance (the
            study's text). `replaced`: it replaces that, and only the first event counts
            (its program).
        joint: every agent earns the sum over all agents, as VDN and QMIX need it;
            finished agents too, while others drive on.
    """

    events: EventRule = "added"
    joint: bool = False


@dataclasses.dataclass(frozen=True)
class RasterConfig(CheckedConfig):
    """The bird's-eye image.

    Attributes:
        pixels: width and height of the image.
        extent: length of a side on the ground [m].
        frames: number of images of the last control steps that an agent observes.
    """

    pixels: Count = 84
    extent: Positive = 50.0
    frames: Count = 3


@dataclasses.dataclass(frozen=True)
class JunctionConfig(CheckedConfig):
    """A junction environment; defaults are the study's, with its text's rewards.

    Attributes:
        scenario: `2av`, `2av-hd`, `3av` or `3av-hd`; from Python also a `Scenario`.
        cars: `path`: points on their routes. `bicycle`: kinematic cars that steer.
            `mjx`: rigid-body cars on tyres, of the batched physics.
        vehicle: preset or file of the cars that steer; cars on paths are SMARTS's box.
        observation: `vector`, or `image`, the bird's-eye view.
        raster: settings of the image.
        action: `index` of one of the four, or a `scalar` in [-1, 1], four ranges of
            which stand for them: the study's MADDPG.
        rewards: what agents earn.
        end: `any`: the episode ends with the first agent that is done. `all`: agents
            leave one by one.
        max_steps: control steps after which it is truncated; the study has 50 to 75.
        shuffle: missions are dealt out to the agents at random.
        probe: episodes begin after one joint `slow_down`, as in the study's program.
        jitter: starts vary by up to this distance along their lanes [m].
        respawn: whether episodes auto-reset within the step.
        sim: time steps of the cars' physics; its control step is the junction's.
    """

    scenario: str | Scenario = "2av"
    cars: CarModel = "path"
    vehicle: str = "city"
    observation: Encoding = "vector"
    raster: RasterConfig = dataclasses.field(default_factory=RasterConfig)
    action: ActionKind = "index"
    rewards: RewardRules = dataclasses.field(default_factory=RewardRules)
    end: EndRule = "any"
    max_steps: Count = 75
    shuffle: bool = False
    probe: bool = False
    jitter: NonNegative = 0.0
    respawn: bool = True
    sim: SimConfig = dataclasses.field(default_factory=lambda: SimConfig(ctrl_dt=0.1))

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "vehicle", with_parameters(self.vehicle))
        for mission in self.traffic.missions:
            lane = path_length(LANES[mission.route.start])
            room = min(mission.start, lane - mission.start)
            self._limit_jitter(room, "off its lane")
        for one, other, moving in self.traffic.queues:
            room = max(abs(one.start - other.start) - QUEUE_GAP, 0.0) / moving
            self._limit_jitter(room, "within another one")

    def _limit_jitter(self, most: float, where: str) -> None:
        if self.jitter > most:
            raise ValueError(
                f"jitter must be at most {most:.2f} m, or a car would start {where}, "
                f"not {self.jitter}"
            )

    @property
    def traffic(self) -> Scenario:
        """Missions and human-driven cars."""
        if isinstance(self.scenario, Scenario):
            return self.scenario
        return scenario(self.scenario)
