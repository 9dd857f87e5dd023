"""Starts and ends of episodes, and what agents see."""

import dataclasses
from typing import Literal

from carpark_mj.config.checks import at_least, choose, positive, ratio

EvolutionRule = Literal["furthest", "random"]
ParkedRule = Literal["tanner", "strict", "precise"]
Encoding = Literal["continuous", "indices"]


@dataclasses.dataclass(frozen=True)
class SpawnConfig:
    """Where agents start an episode, and how the lot goes on when one has parked.

    Attributes:
        close_ratio: share of spawns next to the goal.
        close_distance: longest walk from the point nearest to the goal [m].
        crash_ratio: share of spawns on course for a collision with another agent; what
            is neither close nor this is random.
        crash_distance: least way of that other agent to its goal, and from the point
            where they would meet to that goal [m].
        min_distance: wanted distance to other agents' centres [m]; 7.38 m is Tanner's
            13.125 world units.
        num_candidates: poses drawn per spawn. The first that keeps `min_distance` is
            taken, or the one farthest from the other agents if none does.
        grid: spacing [m] of the points on which starts lie, about the middle of a
            spawn region and up to its edges; 0 = anywhere.
        evolution: which parked car moves into a bay where an agent has parked: the one
            `furthest` from all agents, or a `random` one that no agent tracks.
    """

    close_ratio: float = 0.2
    close_distance: float = 5.625
    crash_ratio: float = 0.0
    crash_distance: float = 7.38
    min_distance: float = 7.38
    num_candidates: int = 16
    grid: float = 0.0
    evolution: EvolutionRule = "furthest"

    def __post_init__(self) -> None:
        ratio(self, "close_ratio", "crash_ratio")
        if self.close_ratio + self.crash_ratio > 1.0:
            raise ValueError(
                "close_ratio + crash_ratio must be at most 1, not "
                f"{self.close_ratio} + {self.crash_ratio}"
            )
        distances = ("close_distance", "crash_distance", "min_distance", "grid")
        at_least(self, 0.0, *distances)
        at_least(self, 1, "num_candidates")
        choose("evolution", self.evolution, EvolutionRule)


@dataclasses.dataclass(frozen=True)
class EpisodeConfig:
    """When an agent's episode ends.

    Attributes:
        parked_rule: what "parked" means. `tanner`: centre within 1.001 world units
            (0.563 m) of the bay's in x and y, at any speed and heading. `strict`:
            footprint within the bay's lines, heading within 5 deg of the bay's axis
            either way round, below 0.2 m/s. `precise`: centre within 0.2 m, heading
            within 3 deg, below 0.05 m/s.
        max_steps: control steps until an episode is cut off (truncated).
        respawn: an agent whose episode ends starts a new one at once; otherwise it
            stays where it is, on the brake, until the lot is reset.
    """

    parked_rule: ParkedRule = "strict"
    max_steps: int = 200
    respawn: bool = True

    def __post_init__(self) -> None:
        choose("parked_rule", self.parked_rule, ParkedRule)
        at_least(self, 1, "max_steps")


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
        encoding: `continuous`, or `indices`: whole numbers for a table, as in the
            study's Q-learning on the grid, `carpark_mj.observations.indices`.
        ring_cars: rings count parked cars and other agents too; with `indices` only.
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

    def __post_init__(self) -> None:
        choose("encoding", self.encoding, Encoding)
        at_least(self, 0, "tracked_agents", "tracked_parked_cars", "rays")
        positive(self, "ray_range")
        at_least(self, 1, "ring_cap")
        if any(not d > 0 for d in self.rings):
            raise ValueError(f"rings must be positive diameters, not {self.rings}")
        if len({f"{d:g}" for d in self.rings}) < len(self.rings):  # the fields' names
            raise ValueError(f"rings must be different diameters, not {self.rings}")
        if self.encoding == "indices":
            if self.tracked_agents or self.tracked_parked_cars:
                raise ValueError(
                    "encoding 'indices' tracks no cars: tracked_agents and "
                    "tracked_parked_cars must be 0, not "
                    f"{self.tracked_agents} and {self.tracked_parked_cars}"
                )
        elif self.ring_cars:
            raise ValueError("ring_cars needs encoding 'indices', not 'continuous'")
