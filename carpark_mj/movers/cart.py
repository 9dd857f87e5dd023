"""A cart that somebody pushes now and then, and that rolls until it stands."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import require_positive
from carpark_mj.config.obstacles import MOVERS, Mover
from carpark_mj.geometry import move_forward
from carpark_mj.geometry.obstacles import Boxes, Group, touches
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.outlines import meet
from carpark_mj.movers.places import Places, make_places
from carpark_mj.movers.stopping import would_hit
from carpark_mj.types import State

SIZE = (1.0, 0.6)  # m, length and width of a shopping cart
ROLLING = 0.15  # m/s², rolling resistance of small wheels: 0.015 g [est]
AHEAD = 1.0  # m before its centre that must be free of bays and walls


class CartState(NamedTuple):
    """Where a cart is: pose (3,), speed () [m/s], and the places of the lot."""

    pose: jax.Array
    speed: jax.Array
    places: Places


@dataclasses.dataclass(frozen=True)
class Cart(Mover):
    """A cart. It stops at walls, bays and movers, and where a car cannot stop.

    Attributes:
        speed: the largest with which it is pushed [m/s].
        pause: mean time that it stands until it is pushed again [s].
        mover: fixed.
    """

    speed: float = 1.5
    pause: float = 10.0
    mover: str = "cart"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "speed", "pause")

    def init(self, key: Any, layout: Layout, others: Sequence[Group] = ()) -> CartState:
        """It stands at a place of the lot."""
        places = make_places(layout)
        place_key, yaw_key = jax.random.split(key)
        order = jax.random.uniform(place_key, places.mask.shape)
        yaw = jax.random.uniform(yaw_key, (1,), maxval=2 * jnp.pi)
        yaw = jnp.broadcast_to(yaw, (*order.shape, 1))
        pose = jnp.concatenate([places.edge, yaw], axis=1)
        # The best is a free place, else one that can be reached.
        free = ~touches(pose, jnp.array(SIZE), others)
        order = order + jnp.where(places.mask, 1.0 + free, 0.0)
        return CartState(pose[jnp.argmax(order)], jnp.float32(0.0), places)

    def begin(self, key: Any, layout: Layout, others: Sequence[Group]) -> CartState:
        """Clear of others."""
        return self.init(key, layout, others)

    def step(self, key: Any, state: CartState, lot: State, dt: float) -> CartState:
        """It rolls on, or is pushed anywhere."""
        when, where, hard = jax.random.split(key, 3)
        pose, speed = state.pose, state.speed
        pushed = (speed == 0.0) & (jax.random.uniform(when) < dt / self.pause)
        yaw = jax.random.uniform(where, maxval=2 * jnp.pi)
        pose = pose.at[2].set(jnp.where(pushed, yaw, pose[2]))
        push = jax.random.uniform(hard, minval=0.3, maxval=1.0) * self.speed
        speed = jnp.where(pushed, push, speed)
        slower = jnp.maximum(speed - ROLLING * dt, 0.0)
        there = move_forward(pose, (speed + slower) / 2 * dt)
        ahead = move_forward(there, AHEAD)
        stops = meet(pose[None, :2], ahead[None, :2], state.places.blocks)[0]
        stops = stops | would_hit(lot, there, jnp.array(SIZE), dt)
        pose = jnp.where(stops, state.pose, there)
        return state._replace(pose=pose, speed=jnp.where(stops, 0.0, slower))

    def obstacles(self, state: CartState) -> list[Boxes]:
        """Its basket."""
        yaw = state.pose[2]
        velocity = state.speed * jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])
        return [Boxes(state.pose[None], jnp.array([SIZE]), velocity[None])]


MOVERS.register("cart", Cart())
