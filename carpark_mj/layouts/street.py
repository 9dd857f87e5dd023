"""Two-way streets with perpendicular or parallel bays on both sides.

Schematics (a) and (b) of Tanner 2022 (arXiv 2206.13338), described there but not built:
one lane each way, rows of bays along both, walls or kerbs around everything.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.config.checks import Range
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import (
    Group,
    assemble,
    bays,
    boundary,
    lanes,
    least_lane,
    spawns_in,
    two_lanes,
)
from carpark_mj.layouts.ranges import IntRange, chances, draw, draw_int, require_ranges
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.turning import Entry
from carpark_mj.layouts.types import Layout, WallKind


@dataclasses.dataclass(frozen=True)
class StreetConfig(LayoutConfig):
    """Ranges of a street with perpendicular bays; lengths [m].

    Attributes:
        bays_per_side: bays in each of the two rows.
        bay_width: across a parked car.
        bay_length: along a parked car.
        aisle_width: of both lanes together.
        end_length: free street between the last bay and the wall across the street.
        wall_thickness: of the walls around.
        car: the car the street is drawn for.
        family: fixed.
    """

    parallel: ClassVar[bool] = False
    bays_per_side: IntRange = (9, 12)
    bay_width: Range = standards.BAY_WIDTH
    bay_length: Range = standards.BAY_LENGTH
    aisle_width: Range = standards.TWO_WAY_AISLE
    end_length: Range = (4.0, 7.0)
    wall_thickness: standards.Thickness = standards.WALL_THICKNESS
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "street"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ranges(self, 1, "bays_per_side")
        require_ranges(self, self.car.width, "bay_width")
        require_ranges(self, self.car.length, "bay_length")
        require_ranges(self, 0.0, "aisle_width", "end_length")
        least = self._entry(0).least(self.car)
        require_aisle(self.aisle_width, max(least, 2 * least_lane(self.car)))

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return 2 * self.bays_per_side[0]

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest entry into a bay."""
        return (self._entry(1),)

    def _entry(self, end: int) -> Entry:
        """The entry from the narrowest aisle (end 0) or the widest (1) into a bay."""
        angle = 0.0 if self.parallel else 90.0
        return Entry(self.aisle_width[end], self.bay_width[end], angle)

    def generate(self, key: jax.Array) -> Layout:
        """Draws a street along x.

        Cars in perpendicular bays point at the street, in parallel bays along the lane
        beside them.
        """
        chance = chances(key, 5)
        count = draw_int(chance[0], self.bays_per_side)
        width = draw(chance[1], self.bay_width)
        length = draw(chance[2], self.bay_length)
        aisle = draw(chance[3], self.aisle_width)
        end = draw(chance[4], self.end_length)
        along, across = (length, width) if self.parallel else (width, length)
        row = jnp.arange(self.bays_per_side[1])
        x = (row + 0.5 - count / 2) * along
        y = (aisle + across) / 2
        # Left of the lane along +x, then right of it.
        yaws = (jnp.pi, 0.0) if self.parallel else (-jnp.pi / 2, jnp.pi / 2)
        pose = jnp.stack(
            [
                jnp.stack(jnp.broadcast_arrays(x, side * y, yaw), axis=-1)
                for side, yaw in zip((1.0, -1.0), yaws, strict=True)
            ]
        )
        half = jnp.stack(
            [count * along / 2 + end, aisle / 2 + across + standards.WALL_GAP]
        )
        kind = WallKind.KERB if self.parallel else WallKind.WALL
        return assemble(
            half,
            bays(pose, jnp.stack([length, width]), mask=row < count),
            boundary(half[0], half[1], self.wall_thickness, kind),
            *two_way_street(self.car, 2 * half[0], aisle),
        )


@dataclasses.dataclass(frozen=True)
class StreetParallelConfig(StreetConfig):
    """Ranges of a street with parallel bays and kerbs around; see `StreetConfig`."""

    parallel: ClassVar[bool] = True
    bays_per_side: IntRange = (9, 11)
    bay_width: Range = standards.PARALLEL_WIDTH
    bay_length: Range = standards.PARALLEL_LENGTH
    family: str = "street_parallel"


def require_aisle(aisle: Range, least: float) -> None:
    """Checks that the car can drive, spawn and turn into the bays.

    Raises:
        ValueError: with the width needed.
    """
    if aisle[0] < least:
        raise ValueError(
            f"aisle_width must be at least {least:.2f} m for the car to turn into a "
            f"bay (carpark_mj.layouts.turning), not {aisle[0]}"
        )


def two_way_street(
    car: DesignCar, length: jax.Array, aisle: jax.Array
) -> tuple[Group, Group]:
    """Two lanes along x about the origin, and the spawn regions in them."""
    pose, size = two_lanes(jnp.zeros(3), jnp.stack([length, aisle]))
    return lanes(pose, size), spawns_in(car, pose, size)


register_layout("street", StreetConfig())
register_layout("street_parallel", StreetParallelConfig())
