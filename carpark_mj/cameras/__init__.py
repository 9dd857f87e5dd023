"""What the cameras of cars see: depth, what it is, and colours; and views from above.

Every obstacle is an upright box or cylinder, so that each pixel's ray meets it and the
ground in closed form, for any number of lots on any device.
"""

from carpark_mj.cameras.blocks import Heights
from carpark_mj.cameras.rig import (
    RIGS,
    Camera,
    FaultConfig,
    Faults,
    Lens,
    Rig,
    Seen,
    draw_faults,
    noisy_depth,
)
from carpark_mj.cameras.see import (
    COLOURS,
    BirdsEye,
    Pictures,
    channels,
    colours,
    grey,
    paint,
    see,
    see_from_above,
)

__all__ = [
    "COLOURS",
    "RIGS",
    "BirdsEye",
    "Camera",
    "FaultConfig",
    "Faults",
    "Heights",
    "Lens",
    "Pictures",
    "Rig",
    "Seen",
    "channels",
    "colours",
    "draw_faults",
    "grey",
    "noisy_depth",
    "paint",
    "see",
    "see_from_above",
]
