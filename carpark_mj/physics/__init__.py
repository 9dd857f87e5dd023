"""Physics back ends: controls in, `VehicleState` out."""

from carpark_mj.physics.base import Physics
from carpark_mj.physics.mjx import MjxPhysics

__all__ = ["MjxPhysics", "Physics"]
