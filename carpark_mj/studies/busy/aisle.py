"""The lot of the busy cases: an aisle between two rows of perpendicular bays."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts.build import (
    assemble,
    bays,
    boundary,
    lanes,
    spawns_in,
    two_lanes,
)
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import Layout, WallKind

COLUMNS = 10  # bays in a row
WIDTH, LENGTH = 2.5, 5.0  # m, of a bay
END = 4.5  # m of aisle beyond the rows
HALF_X = COLUMNS * WIDTH / 2 + END  # m
WALL = 0.25  # m, thickness


def bay_x(column: Any) -> Any:
    """X of the middles of bays [m]."""
    return (column - (COLUMNS - 1) / 2) * WIDTH


def aisle_lot(aisle: jax.Array, absent: jax.Array) -> Layout:
    """A lot; bays 0 to 9 are the lower row, 10 to 19 the upper one, from the left.

    Args:
        aisle: its width [m].
        absent: number of a bay that the lot lacks; -1 = none.
    """
    middle = aisle / 2 + LENGTH / 2
    x = bay_x(jnp.arange(COLUMNS))
    low = jnp.stack(jnp.broadcast_arrays(x, -middle, jnp.pi / 2), axis=-1)
    high = jnp.stack(jnp.broadcast_arrays(x, middle, -jnp.pi / 2), axis=-1)
    there = jnp.arange(2 * COLUMNS) != absent
    half_y = aisle / 2 + LENGTH
    ground = jnp.stack([jnp.float32(2 * HALF_X), aisle])
    lane = two_lanes(jnp.zeros(3), ground)
    return assemble(
        jnp.stack([jnp.float32(HALF_X), half_y]),
        bays(jnp.concatenate([low, high]), (LENGTH, WIDTH), mask=there),
        boundary(HALF_X, half_y, WALL, WallKind.WALL),
        lanes(*lane, one_way=False),
        spawns_in(DesignCar(), jnp.zeros((1, 3)), ground[None]),
    )


@dataclasses.dataclass(frozen=True)
class BusyAisle(LayoutConfig):
    """An aisle between two rows of ten bays.

    Attributes:
        aisle: range of its width [m].
        family: fixed.
    """

    aisle: tuple[float, float] = (6.0, 7.0)
    family: str = "busy_aisle"

    @property
    def min_bays(self) -> int:
        """The fewest bays: one may be absent."""
        return 2 * COLUMNS - 1

    def generate(self, key: jax.Array) -> Layout:
        """Draws the width."""
        low, high = self.aisle
        width = jax.random.uniform(key, minval=low, maxval=high)
        return aisle_lot(width, jnp.int32(-1))
