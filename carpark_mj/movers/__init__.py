"""The library's movers by name: pedestrians, and things that move."""

from carpark_mj.movers.drivers import Drivers
from carpark_mj.movers.pedestrians import Pedestrians

__all__ = ["Drivers", "Pedestrians"]
