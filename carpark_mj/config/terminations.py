"""Ends of episodes: what "parked" means, and when an episode is cut off."""

import dataclasses
import math
from typing import Literal

from carpark_mj.config.checks import (
    CheckedConfig,
    require_positive,
    require_whole,
)
from carpark_mj.config.grid import WORLD_UNIT

ParkedRule = Literal["tanner", "strict", "precise", "metadrive"]


@dataclasses.dataclass(frozen=True)
class ParkedLimits(CheckedConfig):
    """When a car counts as parked in its goal; all limits must hold, None = any.

    Attributes:
        offset: largest distance of centres along either axis of the bay [m].
        distance: largest distance of centres [m].
        from_end: largest distance of the centre from the bay's far end, along its
            axis; between its lines [m].
        inside_lines: the footprint must be within the bay's lines.
        heading: largest angle to the bay's axis, either way round [rad].
        speed: highest speed [m/s].
        before_crash: an agent that parks in a step cannot crash in it.
        slack: smallest margin of a bay's length and width over those of a fleet's car
            for the bay to be its goal [m]; ending within the lines takes some room to
            steer.
    """

    offset: float | None = None
    distance: float | None = None
    from_end: float | None = None
    inside_lines: bool = False
    heading: float | None = None
    speed: float | None = None
    before_crash: bool = False
    slack: float = 0.0


PARKED_RULES: dict[ParkedRule, ParkedLimits] = {
    # The reference implementation of Tanner 2022.
    "tanner": ParkedLimits(offset=1.001 * WORLD_UNIT, before_crash=True),
    "strict": ParkedLimits(
        inside_lines=True, heading=math.radians(5.0), speed=0.2, slack=0.1
    ),
    # ParkBench's 0.2 m and 3 degrees.
    "precise": ParkedLimits(distance=0.2, heading=math.radians(3.0), speed=0.05),
    # MetaDrive's arrival: 5 m about the end of the last lane.
    "metadrive": ParkedLimits(from_end=5.0),
}


@dataclasses.dataclass(frozen=True)
class EpisodeConfig(CheckedConfig):
    """When an agent's episode ends.

    Attributes:
        parked_rule: what "parked" means, by name, see
            `carpark_mj.config.PARKED_RULES`.
        max_steps: control steps until an episode is truncated (timeout).
        hitbox_scale: factor on the cars' lengths and widths in collision tests, in
            evaluations too. Those of walls and discs are not scaled.
        respawn: whether an agent whose episode ends starts a new one at once; otherwise
            it brakes and stays where it is until the lot is reset.
        final_observation: whether `TimeStep` also carries the observation at the end of
            a step, before any respawn; off-policy learners need it.
    """

    parked_rule: ParkedRule = "strict"
    max_steps: int = 200
    hitbox_scale: float = 1.0
    respawn: bool = True
    final_observation: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 1, "max_steps")
        require_positive(self, "hitbox_scale")
