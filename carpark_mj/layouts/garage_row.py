"""A row of tight bays, each between two walls, opposite another wall."""

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
class GarageRowConfig(TightConfig):
    """A row of bays between walls; lengths [m]. See also `TightConfig`.

    Attributes:
        num_bays: range of the number of bays.
        end_length: aisle beyond the last bay on either side.
        family: fixed.
    """

    num_bays: IntRange = (4, 7)
    end_length: Range = (4.0, 6.0)
    family: str = "garage_row"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ranges(self, 1, "num_bays")
        require_ranges(self, 0.0, "end_length")
        super().__post_init__()

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return self.num_bays[0]

    def generate(self, key: jax.Array) -> Layout:
        """Draws a row along x, its bays at the left of the aisle."""
        chance = chances(key, 4)
        most, thickness = self.num_bays[1], self.wall_thickness
        count = draw_int(chance[0], self.num_bays)
        size, cell, yaw = draw_tight_bay(self, chance[1:3])
        end = draw(chance[3], self.end_length)
        aisle = self.room.aisle
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
        bay_pose = jnp.stack(
            jnp.broadcast_arrays(bay_x, edge + cell[1] / 2, yaw), axis=-1
        )
        post_pose = jnp.stack(
            jnp.broadcast_arrays(post_x, edge + depth / 2, 0.0), axis=-1
        )
        return assemble(
            jnp.stack([half_x, half_y]),
            bays(bay_pose, size, mask=row < count),
            boundary(half_x, half_y, thickness, WallKind.WALL),
            walls(
                post_pose,
                jnp.stack([jnp.float32(thickness), depth]),
                mask=post <= count,
            ),
            *two_way_aisle(self.car, 2 * half_x, edge - aisle / 2, aisle),
        )


register_layout("garage_row", GarageRowConfig())
