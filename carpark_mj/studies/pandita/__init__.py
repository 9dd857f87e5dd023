"""Pandita 2022: highway-env's car, and parking slots for a single one."""

from carpark_mj.config import PHYSICS
from carpark_mj.studies.pandita.highway_config import HighwayConfig

PHYSICS.register("highway", HighwayConfig())
