"""Tanner 2022: parking agents that learn to share a lot (arXiv 2206.13338)."""

from carpark_mj.config import ENCODERS, PHYSICS
from carpark_mj.studies.tanner import programs
from carpark_mj.studies.tanner.grid_config import COARSE, FINE, RECORDED
from carpark_mj.studies.tanner.indices import IndexObservation
from carpark_mj.studies.tanner.observation import TannerObservation

__all__ = ["programs"]

PHYSICS.register("grid", FINE)
PHYSICS.register("grid_coarse", COARSE)
PHYSICS.register("grid_recorded", RECORDED)
ENCODERS.register("tanner", TannerObservation)
ENCODERS.register("indices", IndexObservation)
