"""Tanner 2022: parking agents that learn to share a lot."""

from carpark_mj.config import PHYSICS
from carpark_mj.studies.tanner import programs, rewards
from carpark_mj.studies.tanner.grid_config import COARSE, FINE, RECORDED

__all__ = ["programs", "rewards"]

PHYSICS.register("grid", FINE)
PHYSICS.register("grid_coarse", COARSE)
PHYSICS.register("grid_recorded", RECORDED)
