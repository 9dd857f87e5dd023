"""Which cars there are, and how parked cars stand in their bays."""

import dataclasses
import math
from typing import Annotated

from carpark_mj.config.checks import Bounds, CheckedConfig, Range
from carpark_mj.config.vehicles import with_parameters


@dataclasses.dataclass(frozen=True)
class FleetConfig(CheckedConfig):
    """Vehicles to draw cars from; an empty list means `EnvConfig.vehicle`.

    Each is a preset's name or a vehicle file, as `EnvConfig.vehicle` is.

    Attributes:
        agents: presets of the agents, drawn at every spawn.
        agent_weights: relative frequencies of `agents`; empty = equally often.
        parked_cars: presets of the parked cars, drawn when the lot is reset.
        parked_weights: relative frequencies of `parked_cars`; empty = equally often.
    """

    agents: tuple[str, ...] = ()
    agent_weights: Annotated[tuple[float, ...], Bounds(gt=0.0)] = ()
    parked_cars: tuple[str, ...] = ()
    parked_weights: Annotated[tuple[float, ...], Bounds(gt=0.0)] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for names in ("agents", "parked_cars"):
            cars = tuple(map(with_parameters, getattr(self, names)))
            object.__setattr__(self, names, cars)
        for names, weights in (
            ("agents", "agent_weights"),
            ("parked_cars", "parked_weights"),
        ):
            count, given = len(getattr(self, names)), getattr(self, weights)
            if given and len(given) != count:
                raise ValueError(
                    f"{weights} must be one for each of the {count} presets in "
                    f"{names}, not {given}"
                )

    @property
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

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return self != JitterConfig()
