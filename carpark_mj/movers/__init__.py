"""The library's movers by name: people, drivers, things that move, scripts."""

from carpark_mj.movers.drivers import Drivers as Drivers
from carpark_mj.movers.pedestrians import Pedestrians as Pedestrians
from carpark_mj.movers.replay import Replay as Replay
from carpark_mj.movers.scripted import ScriptedBox as ScriptedBox
from carpark_mj.movers.scripted import ScriptedPerson as ScriptedPerson
from carpark_mj.movers.things import Barrier as Barrier
from carpark_mj.movers.things import Cart as Cart
from carpark_mj.movers.things import Door as Door
