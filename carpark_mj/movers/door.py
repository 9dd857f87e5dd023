"""A door of a parked car that opens beside a free bay."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import require_positive
from carpark_mj.config.obstacles import MOVERS, Mover
from carpark_mj.geometry import boxes_overlap, to_world
from carpark_mj.geometry.obstacles import Boxes, touches
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.stopping import would_hit
from carpark_mj.types import State

SIZE = (1.0, 0.1)  # m, a front door
HINGE = 0.2  # of the car's length before its centre
WIDEST = 1.13  # rad, 65°
SWING = 1.5  # s, from closed to open
OPEN = 5.0  # s that it stays open
ROOM = 2.0  # m beside the car that must be free of other parked cars


class DoorState(NamedTuple):
    """A door.

    Attributes:
        car: () int32, which parked car's.
        side: () 1 = left, -1 = right.
        angle: () 0 = closed [rad].
        clock: () time since it began to open, negative while it is closed [s].
        pose: (3,) of its middle.
    """

    car: jax.Array
    side: jax.Array
    angle: jax.Array
    clock: jax.Array
    pose: jax.Array


@dataclasses.dataclass(frozen=True)
class Door(Mover):
    """A door that opens, at another parked car each time.

    It swings neither where a car can no longer stop nor into anybody.

    Attributes:
        pause: mean time that all doors are closed [s].
        mover: fixed.
    """

    pause: float = 10.0
    mover: str = "door"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "pause")

    def init(self, key: Any, layout: Layout) -> DoorState:
        """All doors are closed."""
        del key, layout
        zero = jnp.float32(0.0)
        return DoorState(jnp.int32(0), zero + 1.0, zero, zero - 1.0, jnp.zeros(3))

    def step(self, key: Any, state: DoorState, lot: State, dt: float) -> DoorState:
        """It swings on; a closed one may open, if there is room beside the car."""
        cars = lot.parked_cars
        if not cars.bay.shape[0]:
            return state
        when, which, where = jax.random.split(key, 3)
        closed = state.clock < 0.0
        car = jax.random.randint(which, (), 0, cars.bay.shape[0])
        side = jnp.where(jax.random.bernoulli(where), 1.0, -1.0)
        opens = closed & (jax.random.uniform(when) < dt / self.pause)
        car = jnp.where(closed, car, state.car)
        side = jnp.where(closed, side, state.side)
        pose, size = cars.pose_w[car], cars.size[car]
        zero = jnp.zeros(())
        beside = to_world(pose, jnp.stack([zero, side * (size[1] + ROOM) / 2, zero]))
        room = jnp.stack([size[0], zero + ROOM])
        others = cars.present & (jnp.arange(cars.bay.shape[0]) != car)
        taken = boxes_overlap(beside, room - 0.2, cars.pose_w, cars.size) & others
        opens = opens & ~taken.any() & cars.present[car]
        opens = opens & ~would_hit(lot, beside, room, dt)
        clock = jnp.where(closed, jnp.where(opens, 0.0, -1.0), state.clock + dt)
        goal = jnp.clip(jnp.minimum(clock, 2 * SWING + OPEN - clock) / SWING, 0.0, 1.0)
        angle = WIDEST * goal
        at = _place(pose, size, side, angle)
        # Who comes too near while it opens holds it, and whoever it would touch.
        held = (angle > state.angle) & would_hit(lot, at, jnp.array(SIZE), dt)
        at = at[None]
        held = held | touches(at, jnp.array(SIZE), lot.movers.groups)[0] & ~closed
        angle, clock = (
            jnp.where(held, before, after)
            for before, after in ((state.angle, angle), (state.clock, clock))
        )
        clock = jnp.where(clock > 2 * SWING + OPEN, -1.0, clock)
        return DoorState(car, side, angle, clock, _place(pose, size, side, angle))

    def obstacles(self, state: DoorState) -> list[Boxes]:
        """The door while it is not closed."""
        mask = state.angle > 0.0
        return [Boxes(state.pose[None], jnp.array([SIZE]), mask=mask[None])]


def _place(
    pose: jax.Array, size: jax.Array, side: jax.Array, angle: jax.Array
) -> jax.Array:
    """Pose (3,) of the middle of a door of a car, from the hinge backwards."""
    back = jnp.stack([-jnp.cos(angle), side * jnp.sin(angle)])
    hinge = jnp.stack([HINGE * size[0], side * size[1] / 2])
    middle = hinge + SIZE[0] / 2 * back
    return to_world(pose, jnp.append(middle, jnp.arctan2(back[1], back[0])))


MOVERS.register("door", Door())
