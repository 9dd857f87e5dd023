"""What differs between cars: domain randomization."""

import dataclasses
import math
from typing import ClassVar, Literal

from carpark_mj.config.checks import at_least, choose

DistributionKind = Literal["uniform", "normal"]


@dataclasses.dataclass(frozen=True)
class Distribution:
    """How a parameter varies between cars about its nominal value; off by default.

    With x = mean + width z, the value is nominal (1 + x), or nominal + x if absolute.

    Attributes:
        kind: of z: `uniform` in [-1, 1], or standard `normal` cut off at +- 2.
        width: 0 and a mean of 0 switch the distribution off.
        mean: shifts all cars alike.
        relative: x is a share of the nominal value, else in the parameter's unit.
    """

    kind: DistributionKind = "uniform"
    width: float = 0.0
    mean: float = 0.0
    relative: bool = True

    NORMAL_CUT: ClassVar[float] = 2.0

    def __post_init__(self) -> None:
        choose("kind", self.kind, DistributionKind)
        at_least(self, 0.0, "width")
        if not math.isfinite(self.mean):
            raise ValueError(f"mean must be finite, not {self.mean}")

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return self.width != 0.0 or self.mean != 0.0

    def bounds(self, nominal: float) -> tuple[float, float]:
        """Smallest and largest value that can be drawn."""
        reach = self.width * (self.NORMAL_CUT if self.kind == "normal" else 1.0)
        ends = (self.mean - reach, self.mean + reach)
        if self.relative:
            ends = (nominal * (1.0 + ends[0]), nominal * (1.0 + ends[1]))
        else:
            ends = (nominal + ends[0], nominal + ends[1])
        return min(ends), max(ends)


_ABSOLUTE = Distribution(relative=False)


@dataclasses.dataclass(frozen=True)
class RandomizationConfig:
    """What differs between cars, drawn anew at every spawn; all off by default.

    Attributes:
        mass: of the whole car [kg]; torques stay, so a loaded car is slower.
        cg_x: centre of gravity ahead of the rear axle [m].
        cg_height: centre of gravity above the ground [m].
        friction: factor on the tyres' friction; nominal 1.
        tyre_stiffness: factor on cornering and slip stiffness; nominal 1.
        brake_gain: factor on all brake torques; nominal 1.
        steering_offset: steered but not commanded [rad]; nominal 0, so absolute.
        steering_lag: [s].
    """

    mass: Distribution = dataclasses.field(default_factory=Distribution)
    cg_x: Distribution = dataclasses.field(default_factory=Distribution)
    cg_height: Distribution = dataclasses.field(default_factory=Distribution)
    friction: Distribution = dataclasses.field(default_factory=Distribution)
    tyre_stiffness: Distribution = dataclasses.field(default_factory=Distribution)
    brake_gain: Distribution = dataclasses.field(default_factory=Distribution)
    steering_offset: Distribution = _ABSOLUTE
    steering_lag: Distribution = _ABSOLUTE

    def __post_init__(self) -> None:
        if self.steering_offset.relative:
            raise ValueError("steering_offset must be absolute, its nominal value is 0")

    def distributions(self) -> dict[str, Distribution]:
        """By name, in a fixed order."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return any(d.is_on for d in self.distributions().values())
