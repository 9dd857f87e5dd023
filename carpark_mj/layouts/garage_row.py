"""A row of tight bays, each between two walls, opposite another wall.

The hard cases of the parking literature, with the levels of difficulty of HOPE (Jiang
et al. 2024, arXiv 2405.20579); see `standards.tight_bay`.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import (
    Group,
    assemble,
    bays,
    boundary,
    lanes,
    spawns_in,
    walls,
)
from carpark_mj.layouts.ranges import (
    IntRange,
    Range,
    chances,
    draw,
    draw_int,
    require_at_least,
    require_ranges,
)
from carpark_mj.layouts.standards import DesignCar, Level, Orientation, tight_bay
from carpark_mj.layouts.street import require_aisle
from carpark_mj.layouts.turning import Entry
from carpark_mj.layouts.types import Layout, WallKind


@dataclasses.dataclass(frozen=True)
class GarageRowConfig(LayoutConfig):
    """A row of bays between walls; lengths [m].

    Attributes:
        level: how much room there is.
        orientation: of the bays to the aisle.
        num_bays: range of the number of bays.
        end_length: aisle beyond the last bay on either side.
        wall_thickness: of all walls, those between the bays included.
        car: the car the row is drawn for; the room is measured from its size.
        family: fixed.
    """

    level: Level = "normal"
    orientation: Orientation = "perpendicular"
    num_bays: IntRange = (4, 7)
    end_length: Range = (4.0, 6.0)
    wall_thickness: float = standards.WALL_THICKNESS
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "garage_row"

    def __post_init__(self) -> None:
        require_ranges(self, 1, "num_bays")
        require_ranges(self, 0.0, "end_length")
        require_at_least(self, 0.01, "wall_thickness")
        require_room(self.orientation, self.level, self.car)

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return self.num_bays[0]

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest way into a bay."""
        return (tight_entry(self.orientation, self.level, self.car, 1),)


def tight_entry(
    orientation: Orientation, level: Level, car: DesignCar, end: int
) -> Entry:
    """The way into the tightest (end 0) or roomiest (end 1) bay of a level."""
    room = tight_bay(orientation, level, car)
    if orientation == "parallel":
        return Entry(room.aisle, standards.PARALLEL_WIDTH[end], angle=0.0)
    return Entry(room.aisle, car.width + room.excess[end], walled=True)


def require_room(orientation: Orientation, level: Level, car: DesignCar) -> None:
    """Checks that the aisle of a level is wide enough for the car.

    Raises:
        ValueError: unknown names, or the width needed.
    """
    entry = tight_entry(orientation, level, car, 0)
    require_aisle((entry.aisle, entry.aisle), entry.least(car))


def draw_tight_bay(
    orientation: Orientation, level: Level, car: DesignCar, chance: jax.Array
) -> tuple[jax.Array, jax.Array, float]:
    """Draws the size of the tight bays of a lot, from uniform numbers (2,).

    Returns:
        (2,) length and width, (2,) extent along and across the aisle [m], and the
        heading of bays on the left of an aisle along +x [rad].
    """
    room = tight_bay(orientation, level, car)
    excess = draw(chance[0], room.excess)
    if orientation == "parallel":
        size = jnp.stack(
            [car.length + excess, draw(chance[1], standards.PARALLEL_WIDTH)]
        )
        return size, size, 0.0
    size = jnp.stack([draw(chance[1], standards.BAY_LENGTH), car.width + excess])
    return size, size[::-1], -jnp.pi / 2


def garage_row(config: GarageRowConfig, key: jax.Array) -> Layout:
    """Draws a row along x, its bays at the left of the aisle."""
    chance = chances(key, 4)
    most, thickness = config.num_bays[1], config.wall_thickness
    count = draw_int(chance[0], config.num_bays)
    size, cell, yaw = draw_tight_bay(
        config.orientation, config.level, config.car, chance[1:3]
    )
    end = draw(chance[3], config.end_length)
    aisle = tight_bay(config.orientation, config.level, config.car).aisle
    pitch = cell[0] + thickness
    row = jnp.arange(most)
    bay_x = (row + 0.5 - count / 2) * pitch
    post = jnp.arange(most + 1)
    post_x = (post - count / 2) * pitch
    half_x = (count * pitch + thickness) / 2 + end
    # The aisle lies below the bays, and the lot about the origin.
    depth = cell[1] + standards.WALL_GAP
    half_y = (aisle + depth) / 2
    edge = half_y - depth
    bay_pose = jnp.stack(jnp.broadcast_arrays(bay_x, edge + cell[1] / 2, yaw), axis=-1)
    post_pose = jnp.stack(jnp.broadcast_arrays(post_x, edge + depth / 2, 0.0), axis=-1)
    return assemble(
        jnp.stack([half_x, half_y]),
        bays(bay_pose, size, mask=row < count),
        boundary(half_x, half_y, thickness, WallKind.WALL),
        walls(
            post_pose, jnp.stack([jnp.float32(thickness), depth]), mask=post <= count
        ),
        *two_way_aisle(config.car, 2 * half_x, edge - aisle / 2, aisle),
    )


def two_way_aisle(
    car: DesignCar, length: jax.Array, y: jax.Array, width: float
) -> tuple[Group, Group]:
    """An undivided aisle along x about x = 0, and spawn regions for both ways."""
    size = jnp.stack([length, jnp.float32(width)])
    pose = jnp.stack(
        [
            jnp.stack([jnp.zeros_like(y), y, jnp.full_like(y, yaw)])
            for yaw in (0, jnp.pi)
        ]
    )
    return lanes(pose[:1], size, one_way=False), spawns_in(car, pose, size)
