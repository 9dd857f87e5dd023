"""The interface between physics and task.

One car is one MuJoCo world: cars meet only in the task layer, which detects
collisions with exact box tests. Every function takes any leading batch shape.
"""

from typing import Protocol, TypeVar

import jax

from carpark_mj.types import VehicleState
from carpark_mj.vehicle.vehicle import Vehicle

PhysicsState = TypeVar("PhysicsState")


class Physics(Protocol[PhysicsState]):
    """A physics back end."""

    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> PhysicsState:
        """Cars at rest.

        Args:
            pose_w: (..., 3) poses of the footprints' centres [m, m, rad].
            vehicle: parameters with the same leading shape.
        """
        ...

    def step(self, state: PhysicsState, controls: jax.Array) -> PhysicsState:
        """Advances by one control step.

        Args:
            state: current state.
            controls: (..., 2) steer and pedal in [-1, 1].
        """
        ...

    def read(self, state: PhysicsState) -> VehicleState:
        """What the task may know of the state."""
        ...
