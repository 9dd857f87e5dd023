"""Tight bays between walls: the hard cases of the parking literature.

The levels of difficulty are those of HOPE (Jiang et al. 2024, arXiv 2405.20579); see
`standards.tight_bay`.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.layouts import build, standards
from carpark_mj.layouts.base import LayoutConfig, register_layout
from carpark_mj.layouts.standards import DesignCar, Entry, Level, Orientation, TightBay
from carpark_mj.layouts.types import Layout, WallKind


@dataclasses.dataclass(frozen=True)
class TightConfig(LayoutConfig):
    """Base of the families with tight bays; lengths [m].

    Attributes:
        level: how much room there is.
        orientation: of the bays to the aisle.
        car: the car the lot is drawn for; the room is measured from its size.
    """

    level: Level = "normal"
    orientation: Orientation = "perpendicular"
    car: DesignCar = dataclasses.field(default_factory=DesignCar)

    def __post_init__(self) -> None:
        super().__post_init__()
        entry = self._entry(0)
        build.require_aisle(entry.aisle, entry.least(self.car))

    @property
    def room(self) -> TightBay:
        """The room that the level leaves."""
        return standards.tight_bay(self.orientation, self.level, self.car)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest entry into a bay."""
        return (self._entry(1),)

    def _entry(self, end: int) -> Entry:
        """The entry into the tightest (end 0) or roomiest (end 1) bay."""
        room = self.room
        if self.orientation == "parallel":
            return Entry(room.aisle, standards.PARALLEL_WIDTH[end], angle=0.0)
        return Entry(room.aisle, self.car.width + room.excess[end], walled=True)


def draw_tight_bay(
    config: TightConfig, chance: jax.Array
) -> tuple[jax.Array, jax.Array, float]:
    """Draws the size of the tight bays of a lot from uniform numbers (2,).

    Returns (2,) length and width, (2,) extent along and across the aisle [m], and the
    heading of bays on the left of an aisle along +x [rad].
    """
    excess = build.draw(chance[0], config.room.excess)
    if config.orientation == "parallel":
        width = build.draw(chance[1], standards.PARALLEL_WIDTH)
        size = jnp.stack([config.car.length + excess, width])
        return size, size, 0.0
    length = build.draw(chance[1], standards.BAY_LENGTH)
    size = jnp.stack([length, config.car.width + excess])
    return size, size[::-1], -jnp.pi / 2


def two_way_aisle(
    car: DesignCar, length: jax.Array, y: jax.Array, width: float
) -> tuple[build.Group, build.Group]:
    """An undivided aisle along x about x = 0, and spawn regions for both directions."""
    size = jnp.stack([length, jnp.float32(width)])
    pose = build.stacked(0.0, y, jnp.array([0.0, jnp.pi]))
    return build.lanes(pose[:1], size, one_way=False), build.spawns_in(car, pose, size)


@dataclasses.dataclass(frozen=True)
class DeadEndConfig(TightConfig):
    """Bays on both sides at the end of a narrow blind aisle; lengths [m].

    A car that drives into the aisle must back out or turn in a bay. See also
    `TightConfig`.

    Attributes:
        bays_per_side: bays on each side of the aisle.
        approach: aisle between solid blocks, before the first bay.
        end_length: aisle beyond the last bay, up to the wall across it.
    """

    bays_per_side: standards.Counts = (2, 4)
    approach: standards.Lengths = (12.0, 18.0)
    end_length: standards.Lengths = (0.5, 1.5)
    family: str = "dead_end"

    def __post_init__(self) -> None:
        super().__post_init__()
        build.require_least(self, 2 * self.car.length, "approach")

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return 2 * self.bays_per_side[0]

    def generate(self, key: jax.Array) -> Layout:
        """Draws an aisle along x whose blind end lies at +x."""
        chance = build.chances(key, 5)
        count = build.draw_int(chance[0], self.bays_per_side)
        size, cell, yaw = draw_tight_bay(self, chance[1:3])
        approach = build.draw(chance[3], self.approach)
        end = build.draw(chance[4], self.end_length)
        aisle = self.room.aisle
        depth = cell[1] + standards.WALL_GAP
        half_x = (approach + count * cell[0] + end) / 2
        half_y = aisle / 2 + depth
        row, side = jnp.arange(self.bays_per_side[1]), jnp.array([1.0, -1.0])
        x = approach - half_x + (row + 0.5) * cell[0]
        y = (aisle + cell[1]) / 2
        turn = 0.0 if self.orientation == "perpendicular" else jnp.pi
        yaw = jnp.array([[yaw + turn], [-yaw]])
        bay_pose = build.stacked(x, side[:, None] * y, yaw)
        block = build.stacked(approach / 2 - half_x, side * (aisle + depth) / 2, 0.0)
        return build.assemble(
            jnp.stack([half_x, half_y]),
            build.bays(bay_pose, size, mask=row < count),
            build.boundary(half_x, half_y, standards.WALL_THICKNESS, WallKind.WALL),
            build.walls(block, jnp.stack([approach, depth])),
            *two_way_aisle(self.car, 2 * half_x, jnp.zeros(()), aisle),
        )


@dataclasses.dataclass(frozen=True)
class GarageRowConfig(TightConfig):
    """A row of bays, each between two walls, opposite another wall; lengths [m].

    See also `TightConfig`.

    Attributes:
        num_bays: range of the number of bays.
        end_length: aisle beyond the last bay on either side.
    """

    num_bays: standards.Counts = (4, 7)
    end_length: standards.Lengths = (4.0, 6.0)
    family: str = "garage_row"

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return self.num_bays[0]

    def generate(self, key: jax.Array) -> Layout:
        """Draws a row along x, its bays at the left of the aisle."""
        chance = build.chances(key, 4)
        most, thickness = self.num_bays[1], standards.WALL_THICKNESS
        count = build.draw_int(chance[0], self.num_bays)
        size, cell, yaw = draw_tight_bay(self, chance[1:3])
        end = build.draw(chance[3], self.end_length)
        aisle, pitch = self.room.aisle, cell[0] + thickness
        row, post = jnp.arange(most), jnp.arange(most + 1)
        bay_x, post_x = (row + 0.5 - count / 2) * pitch, (post - count / 2) * pitch
        half_x = (count * pitch + thickness) / 2 + end
        # The aisle lies below the bays, and the lot about the origin.
        depth = cell[1] + standards.WALL_GAP
        half_y = (aisle + depth) / 2
        edge = half_y - depth
        bay_pose = build.stacked(bay_x, edge + cell[1] / 2, yaw)
        post_pose = build.stacked(post_x, edge + depth / 2, 0.0)
        return build.assemble(
            jnp.stack([half_x, half_y]),
            build.bays(bay_pose, size, mask=row < count),
            build.boundary(half_x, half_y, standards.WALL_THICKNESS, WallKind.WALL),
            build.walls(post_pose, build.stacked(thickness, depth), mask=post <= count),
            *two_way_aisle(self.car, 2 * half_x, edge - aisle / 2, aisle),
        )


register_layout("dead_end", DeadEndConfig())
register_layout("garage_row", GarageRowConfig())
