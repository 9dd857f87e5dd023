"""Pandita 2022: parking in slots with SAC and hindsight replay."""

from carpark_mj.config import PHYSICS
from carpark_mj.studies.pandita import programs
from carpark_mj.studies.pandita.highway_config import HighwayConfig

__all__ = ["programs"]

PHYSICS.register("highway", HighwayConfig())
