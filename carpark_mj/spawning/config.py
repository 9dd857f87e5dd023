"""Settings of how episodes start: poses, kinds of cars, and what differs between them.

The code is beside this file; it needs MuJoCo's models of cars, the settings do not.
"""

import dataclasses
import functools
import math
from typing import Annotated, Literal

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    Natural,
    NonNegative,
    Range,
    Ratio,
    data,
    is_off,
)
from carpark_mj.config.vehicles import with_parameters

RelocationRule = Literal["furthest", "random", "any"]


@dataclasses.dataclass(frozen=True)
class SpawnConfig(CheckedConfig):
    """Start poses of agents, and the parked car that moves when an agent has parked.

    Attributes:
        close_ratio: share of spawns next to the goal.
        close_distance: longest walk of such spawns from the point nearest the goal [m].
        conflict_ratio: share of spawns in conflict with another agent: on a collision
            course, or with its goal where goals are dynamic.
        conflict_distance: on a collision course, shortest distance of the other agent
            to its goal, and from the meeting point to that goal [m].
        reverse_ratio: share of spawns on a collision-free path sampled backwards from
            the goal; a training aid.
        misaligned_ratio: share of spawns in the goal bay, over its lines by
            centimetres or askew, or the wrong way round; a training aid for parked
            rules that ask for the lines of the bay. All remaining spawns are random.
        min_distance: desired distance to other agents' centres [m]; 7.38 m is Tanner's
            13.125 world units.
        num_candidates: poses drawn per spawn. The first that keeps `min_distance` is
            taken, or the one with most room to the other agents if none does.
        max_redraws: further rounds of `num_candidates` while none keeps `min_distance`.
        spacing: spacing of the grid of start positions [m], centred in a spawn region
            and including its edges; 0 = anywhere.
        relocation: the parked car that moves into a bay where an agent has parked:
            `furthest` from all agents, a `random` one that no agent tracks, or `any`.
        kinds_at_reset: with dynamic goals, whether the first starts in a lot are of all
            kinds instead of random. With fixed goals they are always of all kinds.
    """

    close_ratio: Ratio = data(0.2, off=0.0)
    close_distance: NonNegative = 5.625
    conflict_ratio: Ratio = data(0.0, off=0.0)
    conflict_distance: NonNegative = 7.38
    reverse_ratio: Ratio = data(0.0, off=0.0)
    misaligned_ratio: Ratio = data(0.0, off=0.0)
    min_distance: NonNegative = 7.38
    num_candidates: Count = 16
    max_redraws: Natural = 0
    spacing: NonNegative = 0.0
    relocation: RelocationRule = "furthest"
    kinds_at_reset: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if math.fsum(self.ratios) > 1.0:
            raise ValueError(
                "close_ratio + conflict_ratio + reverse_ratio + misaligned_ratio must "
                f"be at most 1, not {' + '.join(map(str, self.ratios))}"
            )

    @functools.cached_property
    def ratios(self) -> tuple[float, float, float, float]:
        """Shares of spawns that are close, in conflict, reverse and misaligned."""
        near = self.close_ratio, self.conflict_ratio
        return (*near, self.reverse_ratio, self.misaligned_ratio)


@dataclasses.dataclass(frozen=True)
class FleetConfig(CheckedConfig):
    """Vehicles to draw cars from; an empty list means `EnvConfig.vehicle`.

    Each is a preset's name, a vehicle file, as `EnvConfig.vehicle` is, or `range:N` for
    N cars of many sizes (`carpark_mj.vehicle.presets`).

    Attributes:
        agents: presets of the agents, drawn at every spawn, each equally often.
        parked_cars: presets of the parked cars, drawn when the lot is reset.
        snug: share of the agents' cars drawn with a preference for tight bays; the
            others are uniform over those that fit, mostly small cars in large bays.
    """

    agents: tuple[str, ...] = ()
    parked_cars: tuple[str, ...] = ()
    snug: Ratio = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for names in ("agents", "parked_cars"):
            cars = tuple(map(with_parameters, getattr(self, names)))
            object.__setattr__(self, names, cars)

    @functools.cached_property
    def is_on(self) -> bool:
        """Whether cars of several kinds may meet."""
        return bool(self.agents or self.parked_cars)


@dataclasses.dataclass(frozen=True)
class JitterConfig(CheckedConfig):
    """Ranges of parked cars' poses in their bays and of their sizes; none by default.

    Drawn for every parked car when the lot is reset and kept when it changes its bay.
    A car that fits into its bay stays within the lines, whatever is drawn.

    Attributes:
        along: offset from the bay's centre along its heading [m].
        across: offset from the bay's centre to the left of its heading [m].
        heading: offset from the bay's heading [rad], counter-clockwise.
        scale: factor on the car's length and width.
    """

    along: Annotated[Range, Bounds()] = (0.0, 0.0)
    across: Annotated[Range, Bounds()] = (0.0, 0.0)
    # Beyond a quarter turn a car faces the other way.
    heading: Annotated[Range, Bounds(ge=-math.pi / 2, le=math.pi / 2, unit="rad")] = (
        0.0,
        0.0,
    )
    # Below half or above twice its size it is another kind of car.
    scale: Annotated[Range, Bounds(ge=0.5, le=2.0)] = (1.0, 1.0)

    @property
    def moves(self) -> bool:
        """Whether cars stand off the middle of their bays."""
        neat = (0.0, 0.0)
        return not self.along == self.across == self.heading == neat

    @functools.cached_property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return self != JitterConfig()


_Range = Annotated[Range, Bounds()]
ADDED = ("steering_offset", "steering_lag")  # to the nominal value, which may be 0


@dataclasses.dataclass(frozen=True)
class RandomizationConfig(CheckedConfig):
    """Ranges of the cars' parameters, drawn at every spawn; none by default.

    In `bicycle` physics only `mass`, `brake_gain` and what is added to the steering
    have an effect; `highway` and the grid refuse all.

    Attributes:
        mass: factor on the mass of the whole car; torques are unchanged, so a loaded
            car accelerates more slowly.
        cg_x: factor on the distance of the centre of gravity ahead of the rear axle.
        cg_height: factor on the height of the centre of gravity above the ground.
        friction: factor on the tyres' friction.
        tyre_stiffness: factor on cornering and slip stiffness.
        brake_gain: factor on all brake torques.
        steering_offset: added to the commanded steering angle [rad], left positive.
        steering_lag: added to the steering's time constant [s].
    """

    mass: _Range = data((1.0, 1.0), off=(1.0, 1.0))
    cg_x: _Range = data((1.0, 1.0), off=(1.0, 1.0))
    cg_height: _Range = data((1.0, 1.0), off=(1.0, 1.0))
    friction: _Range = data((1.0, 1.0), off=(1.0, 1.0))
    tyre_stiffness: _Range = data((1.0, 1.0), off=(1.0, 1.0))
    brake_gain: _Range = data((1.0, 1.0), off=(1.0, 1.0))
    steering_offset: _Range = data((0.0, 0.0), off=(0.0, 0.0))
    steering_lag: _Range = data((0.0, 0.0), off=(0.0, 0.0))

    def ranges(self) -> dict[str, Range]:
        """Ranges by name, in a fixed order."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    def varies(self, name: str) -> bool:
        """Whether a parameter may differ from its nominal value."""
        nominal = 0.0 if name in ADDED else 1.0
        return not is_off(getattr(self, name), (nominal, nominal))

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return any(map(self.varies, self.ranges()))
