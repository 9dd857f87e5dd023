"""A two-way street with parallel bays on both sides, schematic (b) of Tanner 2022."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import assemble, bays, boundary, least_lane
from carpark_mj.layouts.ranges import (
    IntRange,
    Range,
    chances,
    draw,
    draw_int,
    require_at_least,
    require_ranges,
)
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.street import require_aisle, two_way_street
from carpark_mj.layouts.turning import Entry, least_parallel_aisle
from carpark_mj.layouts.types import Layout, WallKind


@dataclasses.dataclass(frozen=True)
class StreetParallelConfig(LayoutConfig):
    """Ranges of a street with parallel bays; lengths [m].

    Attributes:
        bays_per_side: bays in each of the two rows.
        bay_width: across a parked car.
        bay_length: along a parked car.
        aisle_width: of both lanes together.
        end_length: free street between the last bay and the wall across the street.
        wall_thickness: of the kerbs and walls around.
        car: the car the street is drawn for.
        family: fixed.
    """

    bays_per_side: IntRange = (9, 11)
    bay_width: Range = standards.PARALLEL_WIDTH
    bay_length: Range = standards.PARALLEL_LENGTH
    aisle_width: Range = standards.TWO_WAY_AISLE
    end_length: Range = (4.0, 7.0)
    wall_thickness: float = standards.WALL_THICKNESS
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "street_parallel"

    def __post_init__(self) -> None:
        require_ranges(self, 1, "bays_per_side")
        require_ranges(self, self.car.width, "bay_width")
        require_ranges(self, self.car.length, "bay_length")
        require_ranges(self, 0.0, "aisle_width", "end_length")
        require_at_least(self, 0.01, "wall_thickness")
        least = least_parallel_aisle(self.car)
        require_aisle(self.aisle_width, max(least, 2 * least_lane(self.car)))

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return 2 * self.bays_per_side[0]

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest way into a bay."""
        return (Entry(self.aisle_width[1], self.bay_width[1], angle=0.0),)


def street_parallel(config: StreetParallelConfig, key: jax.Array) -> Layout:
    """Draws a street along x; parked cars point the way of the lane beside them."""
    chance = chances(key, 5)
    count = draw_int(chance[0], config.bays_per_side)
    width = draw(chance[1], config.bay_width)
    length = draw(chance[2], config.bay_length)
    aisle = draw(chance[3], config.aisle_width)
    end = draw(chance[4], config.end_length)
    row = jnp.arange(config.bays_per_side[1])
    x = (row + 0.5 - count / 2) * length
    y = (aisle + width) / 2
    pose = jnp.stack(
        [
            jnp.stack(jnp.broadcast_arrays(x, s * y, yaw), axis=-1)
            for s, yaw in ((1.0, jnp.pi), (-1.0, 0.0))
        ]
    )
    half_y = aisle / 2 + width + standards.WALL_GAP
    half = jnp.stack([count * length / 2 + end, half_y])
    return assemble(
        half,
        bays(pose, jnp.stack([length, width]), mask=row < count),
        boundary(half[0], half[1], config.wall_thickness, WallKind.KERB),
        *two_way_street(config.car, 2 * half[0], aisle),
    )
