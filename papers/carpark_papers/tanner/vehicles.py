"""The car of Tanner 2022, for the grid."""

import dataclasses

from carpark_mj.config import WORLD_UNIT
from carpark_mj.vehicle import COMPACT, register_vehicle

# 7.9 x 3.9 world units: the colliders are 0.1 smaller than what is drawn.
register_vehicle(
    "tanner",
    dataclasses.replace(COMPACT, length=7.9 * WORLD_UNIT, width=3.9 * WORLD_UNIT),
)
