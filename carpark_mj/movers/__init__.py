"""The library's movers by name: people, drivers, things that move."""

from carpark_mj.movers.barrier import Barrier
from carpark_mj.movers.cart import Cart
from carpark_mj.movers.door import Door
from carpark_mj.movers.drivers import Drivers
from carpark_mj.movers.pedestrians import Pedestrians
from carpark_mj.movers.rail_car import RailCar
from carpark_mj.movers.replay import Replay

__all__ = [
    "Barrier",
    "Cart",
    "Door",
    "Drivers",
    "Pedestrians",
    "RailCar",
    "Replay",
]
