"""Tanner 2022 (arXiv 2206.13338): parking on a grid."""

from carpark_mj.config import PHYSICS
from carpark_mj.studies.tanner.grid_config import COARSE, FINE, RECORDED

PHYSICS.register("grid", FINE)
PHYSICS.register("grid_coarse", COARSE)
PHYSICS.register("grid_recorded", RECORDED)
