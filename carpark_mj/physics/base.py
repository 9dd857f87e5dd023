"""The interface between physics and task.

One car is one MuJoCo world: cars meet only in the task layer, which detects
collisions with exact box tests. Every function takes any leading batch shape.
"""

from typing import Any, Protocol, TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.config import SimConfig
from carpark_mj.types import Motion
from carpark_mj.vehicle.vehicle import Vehicle

PhysicsState = TypeVar("PhysicsState")


class Physics(Protocol[PhysicsState]):
    """A physics back end.

    Attributes:
        contacts: whether cars push each other. If so, `read` reports what they
            touched, and a car that has crashed goes on being simulated.
    """

    contacts: bool

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
            controls: (..., 2) steer and pedal in [-1, 1]; on the grid indices, see
                `GridPhysics`.
        """
        ...

    def place(
        self,
        state: PhysicsState,
        mask: jax.Array,
        pose_w: jax.Array,
        vehicle: Vehicle,
    ) -> PhysicsState:
        """Puts some cars elsewhere, at rest, and leaves the others alone.

        Args:
            state: current state.
            mask: (...) bool, which cars.
            pose_w: (..., 3) poses of the footprints' centres.
            vehicle: parameters (...) of the cars put there.
        """
        ...

    def set_parked_poses(
        self, state: PhysicsState, parked_pose: jax.Array
    ) -> PhysicsState:
        """Tells where the parked cars stand: at the start, and when one has moved.

        Args:
            state: current state.
            parked_pose: (num_parked_cars, 3) poses of their footprints' centres.
        """
        ...

    def read(self, state: PhysicsState) -> Motion:
        """What the task may know of the state."""
        ...


def where_cars(mask: jax.Array, new: Any, old: Any) -> Any:
    """Takes cars from the tree `new` where `mask` (...) is true, else from `old`."""

    def select(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(jnp.expand_dims(mask, range(mask.ndim, a.ndim)), a, b)

    return jax.tree.map(select, new, old)


def require_plain_ground(sim: SimConfig, name: str) -> None:
    """Refuses what a kinematic back end cannot feel.

    Raises:
        ValueError: a slope, a slippery surface or contact tyres.
    """
    felt = {"grade_x": 0.0, "grade_y": 0.0, "surface": "dry", "tyres": "brush"}
    for setting, plain in felt.items():
        value = getattr(sim, setting)
        if value != plain:
            raise ValueError(
                f"{name} physics has no tyres and no ground: {setting} must stay "
                f"{plain!r}, not {value!r}"
            )
