"""A barrier across a lane that opens for cars that come near."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import require_positive
from carpark_mj.config.obstacles import MOVERS, Mover, ObstacleKind
from carpark_mj.geometry import box_distance, to_world
from carpark_mj.geometry.obstacles import Boxes, Group, touches
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.lanes import draw_lane
from carpark_mj.movers.stopping import cars_of
from carpark_mj.types import State

THICK = 0.15  # m, of the beam
STANDING = ObstacleKind.PARKED_CAR, ObstacleKind.WALL
RAISED = 0.05  # share of the beam's length that is left until it is open


class BarrierState(NamedTuple):
    """A barrier: pose (3,) and size (2,) of its lane, share () open, whether there."""

    pose: jax.Array
    size: jax.Array
    is_open: jax.Array
    there: jax.Array


@dataclasses.dataclass(frozen=True)
class Barrier(Mover):
    """A beam across the middle of a lane; lots without lanes have none.

    It closes only while no car is near, and never onto anybody.

    Attributes:
        near: gap to an agent or a driver at which it opens [m].
        duration: of its opening, and of its closing [s].
        mover: fixed.
    """

    near: float = 5.0
    duration: float = 2.0
    mover: str = "barrier"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "near", "duration")

    def init(
        self, key: Any, layout: Layout, others: Sequence[Group] = ()
    ) -> BarrierState:
        """It is closed, or open where somebody stands beneath."""
        pose, size, there = draw_lane(key, layout, 0.0)
        closed = BarrierState(pose, size, jnp.float32(0.0), there)
        # The ends of the beam may reach into walls and parked cars.
        movers = [x for x in others if x.kind not in STANDING]
        under = self._meets(closed, movers)
        return closed._replace(is_open=jnp.where(under, 1.0, closed.is_open))

    def begin(self, key: Any, layout: Layout, others: Sequence[Group]) -> BarrierState:
        """Clear of others."""
        return self.init(key, layout, others)

    def step(
        self, key: Any, state: BarrierState, lot: State, dt: float
    ) -> BarrierState:
        """It opens for a car, and closes behind the last."""
        del key
        closed = self._beam(state._replace(is_open=jnp.float32(0.0)))
        cars = cars_of(lot, dt)
        gap = box_distance(cars.pose, cars.size, *closed)
        change = jnp.where((gap < self.near).any(), dt, -dt) / self.duration
        after = state._replace(is_open=jnp.clip(state.is_open + change, 0.0, 1.0))
        waits = (change < 0.0) & self._meets(after, lot.movers.groups)
        return after._replace(is_open=jnp.where(waits, state.is_open, after.is_open))

    def obstacles(self, state: BarrierState) -> list[Boxes]:
        """The beam until it is open; drivers would wait for what is left of it."""
        pose, size = self._beam(state)
        there = state.there & (state.is_open < 1.0)
        return [Boxes(pose[None], size[None], mask=there[None])]

    def _meets(self, state: BarrierState, others: Sequence[Group]) -> jax.Array:
        """() bool, whether the beam overlaps obstacles."""
        pose, size = self._beam(state)
        return touches(pose[None], size, others)[0]

    def _beam(self, state: BarrierState) -> tuple[jax.Array, jax.Array]:
        """Pose (3,) and size (2,): from the lane's right edge, shorter when raised."""
        width = state.size[1]
        length = width * jnp.maximum(1.0 - state.is_open, RAISED)
        zero = jnp.zeros(())
        local = jnp.stack([zero, (length - width) / 2, zero])
        return to_world(state.pose, local), jnp.stack([zero + THICK, length])


MOVERS.register("barrier", Barrier())
