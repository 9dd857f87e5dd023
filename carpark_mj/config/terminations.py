"""Ends of episodes: what "parked" means, and when an episode is cut off."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

from carpark_mj.config.checks import CheckedConfig, Count, NonNegative, Positive
from carpark_mj.config.insertion import data
from carpark_mj.extensions import Registry

WORLD_UNIT = 0.5625  # m; Tanner's car of 8 world units is then 4.5 m long


@dataclasses.dataclass(frozen=True)
class ParkedRule(CheckedConfig):
    """When a car counts as parked in its goal; all limits must hold, None = any.

    Attributes:
        offset: largest distance of centres along either axis of the bay [m].
        distance: largest distance of centres [m].
        from_end: largest distance of the centre from the bay's far end, along its
            axis; between its lines [m].
        inside_lines: the footprint must be within the bay's lines.
        heading: largest angle to the bay's axis, either way round [rad].
        speed: highest speed [m/s].
        test: what else must hold: a function of the cars' `Motion` (...), the poses
            (..., 3), sizes (..., 2) [m] and ends (...), None = either, of their goals
            that returns (...) bool, in JAX.
        before_crash: an agent that parks in a step cannot crash in it.
        before_timeout: an agent that parks in its last step is not timed out.
        slack: smallest margin of a bay's length and width over those of a fleet's car
            for the bay to be its goal [m]; ending within the lines takes some room to
            steer.
    """

    offset: Positive | None = None
    distance: Positive | None = None
    from_end: Positive | None = None
    inside_lines: bool = False
    heading: Positive | None = None
    speed: Positive | None = None
    test: Callable[..., Any] | None = None
    before_crash: bool = False
    before_timeout: bool = True
    slack: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        limits = ("offset", "distance", "from_end", "heading", "speed")
        given = [name for name in limits if getattr(self, name) is not None]
        if not (given or self.inside_lines or self.test):
            raise ValueError(
                f"a parked rule must have a limit, one of {', '.join(limits)}, "
                "inside_lines and test: without any a car is parked everywhere"
            )


PARKED_RULES: Registry[ParkedRule] = Registry(
    "parked rule", "carpark_mj.tasks.goal_pose"
)
# The reference implementation of Tanner 2022.
PARKED_RULES.register(
    "tanner", ParkedRule(offset=1.001 * WORLD_UNIT, before_crash=True)
)
PARKED_RULES.register(
    "strict",
    ParkedRule(inside_lines=True, heading=math.radians(5.0), speed=0.2, slack=0.1),
)
# ParkBench's 0.2 m and 3 degrees.
PARKED_RULES.register(
    "precise", ParkedRule(distance=0.2, heading=math.radians(3.0), speed=0.05)
)
# MetaDrive's arrival: 5 m about the end of the last lane.
PARKED_RULES.register("metadrive", ParkedRule(from_end=5.0))


def find_rules(names: str) -> tuple[ParkedRule, ...]:
    """The parked rules of a comma-separated list.

    Raises:
        ValueError: an unknown name.
    """
    return tuple(PARKED_RULES[name] for name in names.split(","))


@dataclasses.dataclass(frozen=True)
class EpisodeConfig(CheckedConfig):
    """When an agent's episode ends.

    Attributes:
        parked_rule: what "parked" means, one of `carpark_mj.config.PARKED_RULES`; of
            several, separated by commas, any.
        max_steps: control steps until an episode is truncated (timeout).
        hitbox_scale: factor on the cars' lengths and widths in collision tests, in
            evaluations too. Those of walls and discs are not scaled.
        kerb_speed: highest speed [m/s] at which wheels may touch a kerb, which then
            stops the car; 0 = kerbs are walls. The body passes over kerbs.
        wheel_stops: distance of a wheel stop's face from the far end of every bay but
            parallel ones [m]; 0 = none. It is a kerb, neither observed nor drawn.
        respawn: whether an agent whose episode ends starts a new one at once; otherwise
            it brakes and stays where it is until the lot is reset.
        final_observation: whether `TimeStep` also carries the observation at the end of
            a step, before any respawn; off-policy learners need it.
    """

    parked_rule: str = "strict"
    max_steps: Count = 200
    hitbox_scale: Positive = data(1.0)
    kerb_speed: NonNegative = 0.0
    wheel_stops: NonNegative = 0.0
    respawn: bool = True
    final_observation: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        find_rules(self.parked_rule)  # refuses unknown names
        if self.wheel_stops and not self.kerb_speed:
            raise ValueError(
                f"wheel_stops {self.wheel_stops} needs a kerb_speed above 0 at which "
                "they may be touched"
            )

    @property
    def slack(self) -> float:
        """The largest of the parked rules [m]."""
        return max(rule.slack for rule in find_rules(self.parked_rule))
