"""The car: parameters with sources, its MJCF, and the mapping from actions."""

from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import (
    COMPACT,
    PRESETS,
    VEHICLES,
    preset,
    register_vehicle,
)
from carpark_mj.vehicle.vehicle import Vehicle, make_vehicle

__all__ = [
    "COMPACT",
    "PRESETS",
    "VEHICLES",
    "Vehicle",
    "VehicleParameters",
    "make_vehicle",
    "preset",
    "register_vehicle",
]
