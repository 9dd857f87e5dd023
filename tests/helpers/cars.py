"""All road cars of the library: presets and data sheets."""

from carpark_mj.vehicle import PRESETS, preset
from carpark_mj.vehicle.presets import SHEETS

ROAD_CARS = {name: preset(name) for name in (*PRESETS, *SHEETS)}
