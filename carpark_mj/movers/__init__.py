"""The library's movers by name: people, drivers, things that move, scripts."""

from carpark_mj.movers.drivers import Drivers
from carpark_mj.movers.pedestrians import Pedestrians
from carpark_mj.movers.replay import Replay
from carpark_mj.movers.scripted import ScriptedBox, ScriptedPerson
from carpark_mj.movers.things import Barrier, Cart, Door

__all__ = [
    "Barrier",
    "Cart",
    "Door",
    "Drivers",
    "Pedestrians",
    "Replay",
    "ScriptedBox",
    "ScriptedPerson",
]
