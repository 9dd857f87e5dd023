"""A car that drives to and fro along the middle of a lane, as on a rail."""

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
from carpark_mj.movers.lanes import draw_lane
from carpark_mj.movers.stopping import would_hit
from carpark_mj.types import State

SIZE = (4.3, 1.8)  # m
GAP = 0.5  # m that it keeps from where a car cannot stop, and from other movers
TRIES = 8  # places that are tried when a lot begins


class RailState(NamedTuple):
    """A car on a rail.

    Attributes:
        middle: (3,) pose of the rail's middle.
        half: () half the way of its centre [m].
        way: () from the middle [m].
        speed: () in the direction of the rail [m/s].
        heads: () 1 or -1, where it drives when the way is free.
        there: () bool, whether the lot has a lane for it.
    """

    middle: jax.Array
    half: jax.Array
    way: jax.Array
    speed: jax.Array
    heads: jax.Array
    there: jax.Array


@dataclasses.dataclass(frozen=True)
class RailCar(Mover):
    """A car on a rail; lots without a lane of 10 m have none.

    It stops before others, so nobody is hit who could not have stopped.

    Attributes:
        speed: [m/s].
        mover: fixed.
    """

    speed: float = 1.5
    mover: str = "rail_car"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "speed")

    def init(self, key: Any, layout: Layout, others: Sequence[Group] = ()) -> RailState:
        """It stands somewhere on the rail; without room for it there is none."""
        lane_key, way_key = jax.random.split(key)
        pose, size, there = draw_lane(lane_key, layout, 10.0)
        half = jnp.maximum(size[0] / 2 - SIZE[0] / 2 - GAP, 0.0)
        way = half * jax.random.uniform(way_key, (TRIES,), minval=-1.0)
        tried = jnp.broadcast_to(pose, (TRIES, 3))
        free = ~touches(move_forward(tried, way), jnp.array(SIZE), others)
        way, there = way[jnp.argmax(free)], there & free.any()
        zero = jnp.float32(0.0)
        return RailState(pose, half, way, zero, jnp.float32(1.0), there)

    def begin(self, key: Any, layout: Layout, others: Sequence[Group]) -> RailState:
        """Clear of others."""
        return self.init(key, layout, others)

    def step(self, key: Any, state: RailState, lot: State, dt: float) -> RailState:
        """It drives on if the way is free, and turns round at the ends."""
        del key
        way = jnp.clip(
            state.way + state.heads * self.speed * dt, -state.half, state.half
        )
        size = jnp.array(SIZE) + jnp.array([2 * GAP, 0.0])
        waits = would_hit(lot, move_forward(state.middle, way), size, dt)
        way = jnp.where(waits, state.way, way)
        turns = jnp.abs(way) >= state.half
        heads = jnp.where(turns, -jnp.sign(way), state.heads)
        speed = (way - state.way) / dt
        return state._replace(way=way, speed=speed, heads=heads)

    def obstacles(self, state: RailState) -> list[Boxes]:
        """The car."""
        yaw = state.middle[2]
        velocity = state.speed * jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])
        pose = move_forward(state.middle, state.way)
        size = jnp.array([SIZE])
        return [Boxes(pose[None], size, velocity[None], state.there[None])]


MOVERS.register("rail_car", RailCar())
