"""Physics back ends: controls in, `Motion` out."""

from carpark_mj.physics.base import Physics
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.contact import ContactPhysics
from carpark_mj.physics.grid import GridPhysics
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.physics.scene import ScenePhysics

__all__ = [
    "BicyclePhysics",
    "ContactPhysics",
    "GridPhysics",
    "MjxPhysics",
    "Physics",
    "ScenePhysics",
]
