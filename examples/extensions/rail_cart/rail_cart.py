"""A cart on a rail, up and down an aisle: a mover for carpark_mj."""

import dataclasses
import math

import jax
import jax.numpy as jnp

from carpark_mj.config import MOVERS, Mover
from carpark_mj.obstacles import Boxes

Point = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class RailCart(Mover):
    """A cart that turns round at the ends of its rail.

    Attributes:
        start: one end of the rail, of the cart's centre [m].
        end: the other one [m].
        speed: [m/s].
        size: length and width of the cart [m].
        mover: fixed.
    """

    start: Point = (-8.0, 0.0)
    end: Point = (8.0, 0.0)
    speed: float = 1.0
    size: Point = (1.6, 0.9)
    mover: str = "rail_cart"

    def __post_init__(self):
        super().__post_init__()
        if self.length <= 0:
            raise ValueError(f"a rail must not end where it starts, {self.start}")

    @property
    def length(self):
        """Of the rail [m]."""
        return math.dist(self.start, self.end)

    def init(self, key, layout):
        """The way since it left the start, to and fro [m]: anywhere at first."""
        return jax.random.uniform(key, maxval=2 * self.length)

    def step(self, key, state, lot, dt):
        """It goes on, whatever is in its way."""
        return jnp.mod(state + self.speed * dt, 2 * self.length)

    def obstacles(self, state):
        """The cart, nose towards the end of the rail either way."""
        x, y = (b - a for a, b in zip(self.start, self.end, strict=True))
        ahead = jnp.array([x, y]) / self.length
        back = state > self.length
        way = jnp.where(back, 2 * self.length - state, state)
        xy = jnp.array(self.start) + way * ahead
        speed = jnp.where(back, -self.speed, self.speed)
        pose = jnp.append(xy, math.atan2(y, x))
        return [Boxes(pose[None], jnp.array([self.size]), (speed * ahead)[None])]


MOVERS.register("rail_cart", RailCart())
