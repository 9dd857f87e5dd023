"""What the cameras of cars see: depth, what it is, and colours; and views from above.

Every obstacle is an upright box or cylinder, so that each pixel's ray meets it and the
ground in closed form, for any number of lots on any device.
"""

from carpark_mj.cameras.birds_eye import BirdsEye, channels, see_from_above
from carpark_mj.cameras.blocks import Heights
from carpark_mj.cameras.colour import COLOURS, colours, grey, paint
from carpark_mj.cameras.faults import FaultConfig, Faults, draw_faults, noisy_depth
from carpark_mj.cameras.lens import Lens
from carpark_mj.cameras.rig import RIGS, Camera, Rig, Seen
from carpark_mj.cameras.see import Pictures, see

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
