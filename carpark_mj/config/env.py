"""The environment's configuration."""

import dataclasses
from typing import Literal, get_args

from carpark_mj.config.checks import at_least, choose
from carpark_mj.config.fleet import FleetConfig, JitterConfig, Range, require_range
from carpark_mj.config.giving_way import GivingWayConfig
from carpark_mj.config.goals import GoalConfig
from carpark_mj.config.grid import GridConfig
from carpark_mj.config.layout import (
    LAYOUT_FILES,
    LayoutChoice,
    LayoutConfig,
    LayoutName,
)
from carpark_mj.config.metrics import MetricsConfig
from carpark_mj.config.observation import (
    ContinuousObservation,
    IndexObservation,
    Observation,
    TannerObservation,
)
from carpark_mj.config.reward import RewardConfig
from carpark_mj.config.simulation import SimConfig
from carpark_mj.config.spawning import SpawnConfig
from carpark_mj.config.terminations import EpisodeConfig
from carpark_mj.config.variation import RandomizationConfig, SensorConfig

PhysicsName = Literal["mjx", "scene", "bicycle", "grid"]


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """A parking environment.

    Attributes:
        layout: the lot, by name: `tanner` (the study's square, 3.375 m x 5.625 m
            bays), `compact` (the same with 2.5 m x 5.0 m bays), or a family with its
            default settings: `street`, `street_parallel`, `angled`, `lot`,
            `garage_row`, `dead_end`, `mixture`. Or a layout file (.json, or a TPCAP
            case as .csv). Several, with commas between, are a mixture of them. From
            Python also the config of a family, see
            `carpark_mj.layouts`.
        vehicle: name of a preset in `carpark_mj.vehicle`.
        num_agents: cars that act.
        num_parked_cars: cars standing in bays.
        occupancy: share of the lot's bays that hold a parked car, drawn from this range
            when the lot is reset; `num_parked_cars` is then the most there can be.
        fleet: presets that cars are drawn from instead of `vehicle`.
        jitter: how untidily parked cars stand, and their sizes.
        physics: back end. `mjx`: every car alone, crashes by box tests. `scene`: the
            whole lot in one C MuJoCo world, crashes by its contacts; slow. `bicycle`:
            kinematic cars whose tyres never slip. `grid`: the grid world of the study,
            with whole numbers for actions.
        sim: time steps and ground.
        grid: granularities of `grid` physics.
        goals: who decides the goals.
        giving_way: when agents that choose goals should give them up.
        spawn: where episodes start.
        episode: when they end.
        reward: reward weights.
        observation: what agents observe; one config per encoding.
        randomization: what differs between cars.
        sensors: errors of what agents observe.
        metrics: what is measured beside the outcomes.
    """

    layout: LayoutChoice = "tanner"
    vehicle: str = "compact"
    num_agents: int = 2
    num_parked_cars: int = 16
    occupancy: Range | None = None
    fleet: FleetConfig = dataclasses.field(default_factory=FleetConfig)
    jitter: JitterConfig = dataclasses.field(default_factory=JitterConfig)
    physics: PhysicsName = "mjx"
    sim: SimConfig = dataclasses.field(default_factory=SimConfig)
    grid: GridConfig = dataclasses.field(default_factory=GridConfig)
    goals: GoalConfig = dataclasses.field(default_factory=GoalConfig)
    giving_way: GivingWayConfig = dataclasses.field(default_factory=GivingWayConfig)
    spawn: SpawnConfig = dataclasses.field(default_factory=SpawnConfig)
    episode: EpisodeConfig = dataclasses.field(default_factory=EpisodeConfig)
    reward: RewardConfig = dataclasses.field(default_factory=RewardConfig)
    observation: Observation = dataclasses.field(default_factory=ContinuousObservation)
    randomization: RandomizationConfig = dataclasses.field(default_factory=RandomizationConfig)
    sensors: SensorConfig = dataclasses.field(default_factory=SensorConfig)
    metrics: MetricsConfig = dataclasses.field(default_factory=MetricsConfig)

    def __post_init__(self) -> None:
        if not isinstance(self.layout, LayoutConfig | str):  # pyright: ignore
            raise ValueError(f"layout must be a name or a config, not {self.layout!r}")
        for name in self.layout.split(",") if isinstance(self.layout, str) else ():
            if not name.endswith(LAYOUT_FILES) and name not in get_args(LayoutName):
                raise ValueError(
                    f"unknown layout {name!r}; choose from "
                    f"{sorted(get_args(LayoutName))}, or name a file "
                    f"({', '.join(LAYOUT_FILES)})"
                )
        choose("physics", self.physics, PhysicsName)
        at_least(self, 1, "num_agents")
        at_least(self, 0, "num_parked_cars")
        if self.occupancy is not None:
            require_range("occupancy", self.occupancy, 0.0, 1.0)
        self._check_goals()
        self._check_observation()

    def _check_goals(self) -> None:
        scheme = self.giving_way.scheme
        if scheme is not None and not self.goals.dynamic:
            raise ValueError(
                f"giving_way.scheme {scheme!r} needs dynamic goals, goals.dynamic = "
                "True"
            )
        if self.goals.dynamic:
            self.reward.goals.check()

    def _check_observation(self) -> None:
        seen = self.observation
        if isinstance(seen, IndexObservation):
            if self.physics != "grid":
                raise ValueError(
                    f"observation 'indices' needs grid physics, not {self.physics}"
                )
            if self.goals.dynamic:
                raise ValueError(
                    "observation 'indices' needs fixed goals, not dynamic ones"
                )
            return
        scheme = self.giving_way.scheme
        asked = self.giving_way.global_information
        if scheme is not None and seen.global_information != asked:
            raise ValueError(
                f"giving_way.scheme {scheme!r} needs observation.global_information = "
                f"{asked}, not {seen.global_information}"
            )
        if self.goals.dynamic and seen.share.goal_headings:
            raise ValueError(
                "observation.share.goal_headings needs fixed goals, goals.dynamic = "
                "False"
            )
        if isinstance(seen, TannerObservation):
            others = self.num_agents - 1 + self.num_parked_cars
            if seen.tracked_cars > others:
                raise ValueError(
                    f"observation.tracked_cars must be at most {others} (the other "
                    f"{self.num_agents - 1} agents and {self.num_parked_cars} parked "
                    f"cars), not {seen.tracked_cars}"
                )
        elif self.fleet.agents and not seen.own_car:
            raise ValueError(
                "observation.own_car must be True with fleet.agents: agents that are "
                "not all alike must know what they drive"
            )

    @property
    def varies(self) -> bool:
        """Whether there is more than one kind of car, always as many, neatly parked."""
        return (
            self.fleet.is_on or self.jitter.is_on or self.occupancy is not None
        )
