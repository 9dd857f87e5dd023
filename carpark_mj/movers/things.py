"""Things that move: a barrier, a cart and a door."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Positive
from carpark_mj.geometry import box_distance, move_forward, to_world
from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind, touches
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.bodies import meet
from carpark_mj.movers.people import Places, make_places
from carpark_mj.movers.stopping import cars_of, would_hit
from carpark_mj.obstacles import MOVERS, Mover, lot_obstacles
from carpark_mj.types import State

BEAM = 0.15  # m, thickness of a barrier
RAISED = 0.05  # share of its length that is left until it is open
STANDING = ObstacleKind.PARKED_CAR, ObstacleKind.WALL

CART = (1.0, 0.6)  # m, length and width of a shopping cart
ROLLING = 0.15  # m/s², rolling resistance of small wheels: 0.015 g [est]
AHEAD = 1.0  # m before a cart's centre that must be free of bays and walls

DOOR = (1.0, 0.1)  # m, a front door
HINGE = 0.2  # of the car's length before its centre
WIDEST = 1.13  # rad, 65°
SWING = 1.5  # s, from closed to open
OPEN = 5.0  # s that it stays open
BESIDE = 2.0  # m beside the car that must be free of other parked cars


def draw_lane(key: jax.Array, layout: Layout) -> tuple[jax.Array, jax.Array, jax.Array]:
    """A random lane: pose (3,), size (2,), and () bool, whether the lot has one."""
    if not layout.lane_mask.shape[0]:
        return jnp.zeros(3), jnp.ones(2), jnp.bool_(False)
    order = jax.random.uniform(key, layout.lane_mask.shape)
    lane = jnp.argmax(jnp.where(layout.lane_mask, order, -1.0))
    return layout.lane_pose[lane], layout.lane_size[lane], layout.lane_mask[lane]


class BarrierState(NamedTuple):
    """A barrier across a lane."""

    pose: jax.Array  # (3,) of the lane
    size: jax.Array  # (2,) of the lane [m]
    is_open: jax.Array  # () share
    there: jax.Array  # () bool, whether the lot has a lane for it

    @property
    def beam(self) -> tuple[jax.Array, jax.Array]:
        """Pose (3,) and size (2,): from the lane's right edge, shorter when raised."""
        width = self.size[1]
        length = width * jnp.maximum(1.0 - self.is_open, RAISED)
        zero = jnp.zeros(())
        local = jnp.stack([zero, (length - width) / 2, zero])
        return to_world(self.pose, local), jnp.stack([zero + BEAM, length])

    def meets(self, others: Sequence[Group]) -> jax.Array:
        """() bool, whether the beam overlaps obstacles."""
        pose, size = self.beam
        return touches(pose[None], size, others)[0]


@dataclasses.dataclass(frozen=True)
class Barrier(Mover):
    """A beam across the middle of a lane; lots without lanes have none.

    It closes only while no car is near, and never onto anybody.

    Attributes:
        near: gap to an agent or a driver at which it opens [m].
        duration: of its opening, and of its closing [s].
    """

    near: Positive = 5.0
    duration: Positive = 2.0
    mover: str = "barrier"

    def init(
        self, key: jax.Array, layout: Layout, others: Sequence[Group] = ()
    ) -> BarrierState:
        """It is closed, or open where a mover stands beneath."""
        pose, size, there = draw_lane(key, layout)
        closed = BarrierState(pose, size, jnp.float32(0.0), there)
        # The ends of the beam may reach into walls and parked cars.
        under = closed.meets([x for x in others if x.kind not in STANDING])
        return closed._replace(is_open=jnp.where(under, 1.0, closed.is_open))

    begin = init

    def step(
        self, key: jax.Array, state: BarrierState, lot: State, dt: float
    ) -> BarrierState:
        """It opens for a car, and closes behind the last."""
        closed = state._replace(is_open=jnp.float32(0.0))
        cars = cars_of(lot, dt)
        gap = box_distance(cars.pose, cars.size, *closed.beam)
        change = jnp.where((gap < self.near).any(), dt, -dt) / self.duration
        after = state._replace(is_open=jnp.clip(state.is_open + change, 0.0, 1.0))
        waits = (change < 0.0) & after.meets(lot.movers.groups)
        return after._replace(is_open=jnp.where(waits, state.is_open, after.is_open))

    def obstacles(self, state: BarrierState) -> list[Boxes]:
        """The beam until it is open; drivers would wait for the rest of it."""
        pose, size = state.beam
        there = state.there & (state.is_open < 1.0)
        return [Boxes(pose[None], size[None], mask=there[None])]


class CartState(NamedTuple):
    """A cart, and the places of its lot."""

    pose: jax.Array  # (3,)
    speed: jax.Array  # () [m/s]
    places: Places


@dataclasses.dataclass(frozen=True)
class Cart(Mover):
    """A cart that is pushed now and then and rolls until it stands.

    It stops at walls, bays and movers, and where a car cannot stop.

    Attributes:
        speed: the largest with which it is pushed [m/s].
        pause: mean time that it stands until it is pushed again [s].
    """

    speed: Positive = 1.5
    pause: Positive = 10.0
    mover: str = "cart"

    def init(
        self, key: jax.Array, layout: Layout, others: Sequence[Group] = ()
    ) -> CartState:
        """It stands at a place of the lot."""
        places = make_places(layout)
        place_key, yaw_key = jax.random.split(key)
        order = jax.random.uniform(place_key, places.mask.shape)
        yaw = jax.random.uniform(yaw_key, (1,), maxval=2 * jnp.pi)
        yaw = jnp.broadcast_to(yaw, (*order.shape, 1))
        pose = jnp.concatenate([places.edge, yaw], axis=1)
        # The best is a free place, else one that can be reached.
        free = ~touches(pose, jnp.array(CART), others)
        order = order + jnp.where(places.mask, 1.0 + free, 0.0)
        return CartState(pose[jnp.argmax(order)], jnp.float32(0.0), places)

    begin = init

    def step(
        self, key: jax.Array, state: CartState, lot: State, dt: float
    ) -> CartState:
        """It rolls on, or is pushed anywhere."""
        pose, speed = state.pose, state.speed

        @jax.vmap  # at once, as each call of the generator is a loop
        def draw(key: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
            return jax.random.uniform(key, minval=low, maxval=high)

        low, high = jnp.array([[0.0, 0.0, 0.3], [1.0, 2 * jnp.pi, 1.0]])
        chance, yaw, push = draw(jax.random.split(key, 3), low, high)
        pushed = (speed == 0.0) & (chance < dt / self.pause)
        pose = pose.at[2].set(jnp.where(pushed, yaw, pose[2]))
        speed = jnp.where(pushed, push * self.speed, speed)
        slower = jnp.maximum(speed - ROLLING * dt, 0.0)
        there = move_forward(pose, (speed + slower) / 2 * dt)
        ahead = move_forward(there, AHEAD)
        stops = meet(pose[None, :2], ahead[None, :2], state.places.blocks)[0]
        stops = stops | would_hit(lot, there, jnp.array(CART), dt)
        pose = jnp.where(stops, state.pose, there)
        return state._replace(pose=pose, speed=jnp.where(stops, 0.0, slower))

    def obstacles(self, state: CartState) -> list[Boxes]:
        """Its basket."""
        yaw = state.pose[2]
        velocity = state.speed * jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])
        return [Boxes(state.pose[None], jnp.array([CART]), velocity[None])]


class DoorState(NamedTuple):
    """A door of a parked car."""

    car: jax.Array  # () int32, which parked car's
    side: jax.Array  # () 1 = left, -1 = right
    angle: jax.Array  # () 0 = closed [rad]
    clock: jax.Array  # () time since it began to open, negative while closed [s]
    pose: jax.Array  # (3,) of its middle


@dataclasses.dataclass(frozen=True)
class Door(Mover):
    """A door that opens where there is room beside a parked car, another each time.

    It swings neither where a car can no longer stop nor into anybody.

    Attributes:
        pause: mean time that all doors are closed [s].
    """

    pause: Positive = 10.0
    mover: str = "door"

    def init(self, key: jax.Array, layout: Layout) -> DoorState:
        """All doors are closed."""
        zero = jnp.float32(0.0)
        return DoorState(jnp.int32(0), zero + 1.0, zero, zero - 1.0, jnp.zeros(3))

    def step(
        self, key: jax.Array, state: DoorState, lot: State, dt: float
    ) -> DoorState:
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
        beside = to_world(pose, jnp.stack([zero, side * (size[1] + BESIDE) / 2, zero]))
        room = jnp.stack([size[0], zero + BESIDE])
        parked, *walls = lot_obstacles(lot.layout, None, cars)
        others = cars.present & (jnp.arange(cars.bay.shape[0]) != car)
        bodies = [dataclasses.replace(parked, mask=others), *walls]
        opens = opens & cars.present[car]
        opens = opens & ~touches(beside[None], room - 0.2, bodies)[0]
        opens = opens & ~would_hit(lot, beside, room, dt)
        clock = jnp.where(closed, jnp.where(opens, 0.0, -1.0), state.clock + dt)
        goal = jnp.clip(jnp.minimum(clock, 2 * SWING + OPEN - clock) / SWING, 0.0, 1.0)
        angle = WIDEST * goal
        at = _door_pose(pose, size, side, angle)
        # An obstacle too near while it opens, or in its way, holds it.
        held = (angle > state.angle) & would_hit(lot, at, jnp.array(DOOR), dt)
        at = at[None]
        held = held | touches(at, jnp.array(DOOR), lot.movers.groups)[0] & ~closed
        angle, clock = (
            jnp.where(held, before, after)
            for before, after in ((state.angle, angle), (state.clock, clock))
        )
        clock = jnp.where(clock > 2 * SWING + OPEN, -1.0, clock)
        return DoorState(car, side, angle, clock, _door_pose(pose, size, side, angle))

    def obstacles(self, state: DoorState) -> list[Boxes]:
        """The door while it is not closed."""
        mask = state.angle > 0.0
        return [Boxes(state.pose[None], jnp.array([DOOR]), mask=mask[None])]


def _door_pose(
    pose: jax.Array, size: jax.Array, side: jax.Array, angle: jax.Array
) -> jax.Array:
    """Pose (3,) of the middle of a door of a car, from the hinge backwards."""
    back = jnp.stack([-jnp.cos(angle), side * jnp.sin(angle)])
    hinge = jnp.stack([HINGE * size[0], side * size[1] / 2])
    middle = hinge + DOOR[0] / 2 * back
    return to_world(pose, jnp.append(middle, jnp.arctan2(back[1], back[0])))


MOVERS.register("barrier", Barrier())
MOVERS.register("cart", Cart())
MOVERS.register("door", Door())
