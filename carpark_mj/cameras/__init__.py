"""What the cameras of cars see: depth, what it is, and colours; and views from above.

Every obstacle is an upright box or cylinder, so that each pixel's ray meets it and the
ground in closed form, for any number of lots on any device.
"""

from carpark_mj.cameras.blocks import Heights as Heights
from carpark_mj.cameras.rig import RIGS as RIGS
from carpark_mj.cameras.rig import Camera as Camera
from carpark_mj.cameras.rig import FaultConfig as FaultConfig
from carpark_mj.cameras.rig import Faults as Faults
from carpark_mj.cameras.rig import Lens as Lens
from carpark_mj.cameras.rig import Rig as Rig
from carpark_mj.cameras.rig import Seen as Seen
from carpark_mj.cameras.rig import draw_faults as draw_faults
from carpark_mj.cameras.rig import noisy_depth as noisy_depth
from carpark_mj.cameras.see import COLOURS as COLOURS
from carpark_mj.cameras.see import BirdsEye as BirdsEye
from carpark_mj.cameras.see import Pictures as Pictures
from carpark_mj.cameras.see import colours as colours
from carpark_mj.cameras.see import paint as paint
from carpark_mj.cameras.see import see as see
from carpark_mj.cameras.see import see_from_above as see_from_above
