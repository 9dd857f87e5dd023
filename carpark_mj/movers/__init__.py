"""The library's movers by name: pedestrians, drivers, recorded drives."""

from carpark_mj.movers.drivers import Drivers
from carpark_mj.movers.pedestrians import Pedestrians
from carpark_mj.movers.replay import Replay

__all__ = ["Drivers", "Pedestrians", "Replay"]
