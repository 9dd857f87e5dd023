"""The car: parameters with sources, its MJCF, and the mapping from actions."""

from carpark_mj.vehicle.parameters import VehicleParameters as VehicleParameters
from carpark_mj.vehicle.presets import COMPACT as COMPACT
from carpark_mj.vehicle.presets import PRESETS as PRESETS
from carpark_mj.vehicle.presets import VEHICLES as VEHICLES
from carpark_mj.vehicle.presets import preset as preset
from carpark_mj.vehicle.presets import register_vehicle as register_vehicle
from carpark_mj.vehicle.vehicle import Vehicle as Vehicle
from carpark_mj.vehicle.vehicle import make_vehicle as make_vehicle
