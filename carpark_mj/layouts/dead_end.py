"""Tight bays on both sides at the end of a narrow blind aisle.

Unlike in `garage_row` the bays lie side by side, and a car that drives into the aisle
must back out or turn in a bay.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import register_layout
from carpark_mj.config.checks import Range
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import assemble, bays, boundary, walls
from carpark_mj.layouts.ranges import IntRange, chances, draw, draw_int, require_ranges
from carpark_mj.layouts.tight import TightConfig, draw_tight_bay, two_way_aisle
from carpark_mj.layouts.types import Layout, WallKind


@dataclasses.dataclass(frozen=True)
class DeadEndConfig(TightConfig):
    """Bays at the end of a blind aisle; lengths [m]. See also `TightConfig`.

    Attributes:
        bays_per_side: bays on each side of the aisle.
        approach: aisle between solid blocks, before the first bay.
        end_length: aisle beyond the last bay, up to the wall across it.
        family: fixed.
    """

    bays_per_side: IntRange = (2, 4)
    approach: Range = (12.0, 18.0)
    end_length: Range = (0.5, 1.5)
    family: str = "dead_end"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ranges(self, 1, "bays_per_side")
        require_ranges(self, 2 * self.car.length, "approach")
        require_ranges(self, 0.0, "end_length")
        super().__post_init__()

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return 2 * self.bays_per_side[0]

    def generate(self, key: jax.Array) -> Layout:
        """Draws an aisle along x whose blind end lies at +x."""
        chance = chances(key, 5)
        count = draw_int(chance[0], self.bays_per_side)
        size, cell, yaw = draw_tight_bay(self, chance[1:3])
        approach = draw(chance[3], self.approach)
        end = draw(chance[4], self.end_length)
        aisle = self.room.aisle
        depth = cell[1] + standards.WALL_GAP
        half_x = (approach + count * cell[0] + end) / 2
        half_y = aisle / 2 + depth
        row = jnp.arange(self.bays_per_side[1])
        x = approach - half_x + (row + 0.5) * cell[0]
        y = (aisle + cell[1]) / 2
        turn = 0.0 if self.orientation == "perpendicular" else jnp.pi
        bay_pose = jnp.stack(
            [
                jnp.stack(jnp.broadcast_arrays(x, s * y, s * yaw + way), axis=-1)
                for s, way in ((1.0, turn), (-1.0, 0.0))
            ]
        )
        block_y = (aisle + depth) / 2
        block_x = approach / 2 - half_x
        block = jnp.stack(
            [jnp.stack([block_x, s * block_y, 0 * depth]) for s in (1, -1)]
        )
        return assemble(
            jnp.stack([half_x, half_y]),
            bays(bay_pose, size, mask=row < count),
            boundary(half_x, half_y, self.wall_thickness, WallKind.WALL),
            walls(block, jnp.stack([approach, depth])),
            *two_way_aisle(self.car, 2 * half_x, jnp.zeros(()), aisle),
        )


register_layout("dead_end", DeadEndConfig())
