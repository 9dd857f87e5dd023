"""What differs between cars: domain randomization."""

import dataclasses
from typing import Annotated

from carpark_mj.config.checks import Bounds, CheckedConfig, Range

_Range = Annotated[Range, Bounds()]
ADDED = ("steering_offset", "steering_lag")  # to the nominal value, which may be 0


@dataclasses.dataclass(frozen=True)
class RandomizationConfig(CheckedConfig):
    """Ranges of what differs between cars, drawn at every spawn; nothing by default.

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

    mass: _Range = (1.0, 1.0)
    cg_x: _Range = (1.0, 1.0)
    cg_height: _Range = (1.0, 1.0)
    friction: _Range = (1.0, 1.0)
    tyre_stiffness: _Range = (1.0, 1.0)
    brake_gain: _Range = (1.0, 1.0)
    steering_offset: _Range = (0.0, 0.0)
    steering_lag: _Range = (0.0, 0.0)

    def ranges(self) -> dict[str, Range]:
        """Ranges by name, in a fixed order."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    def varies(self, name: str) -> bool:
        """Whether a parameter may differ from its nominal value."""
        nominal = 0.0 if name in ADDED else 1.0
        return getattr(self, name) != (nominal, nominal)

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return self != RandomizationConfig()
