"""Obstacles: all that agents can hit, see and keep away from, in one list."""

from carpark_mj.geometry.obstacles import Boxes, Discs, Group
from carpark_mj.obstacles.lot import lot_obstacles

__all__ = ["Boxes", "Discs", "Group", "lot_obstacles"]
