"""A family of lots: courts with a row of bays on one side."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.layouts import DesignCar, WallKind
from carpark_mj.layouts.build import assemble, bays, boundary, spawns_in


@dataclasses.dataclass(frozen=True)
class CourtConfig(LayoutConfig):
    """A court with a row of bays on one side; lengths [m].

    Attributes:
        num_bays: range of the number of bays.
        depth: range of the open ground in front of them.
        family: fixed.
    """

    num_bays: tuple[int, int] = (6, 10)
    depth: tuple[float, float] = (8.0, 12.0)
    family: str = "court"

    @property
    def min_bays(self):
        """The fewest bays that any key gives."""
        return self.num_bays[0]

    def generate(self, key):
        """Draws a court; parked cars point into it."""
        width, length = 2.5, 5.0
        count_key, depth_key = jax.random.split(key)
        least, most = self.num_bays
        count = jax.random.randint(count_key, (), least, most + 1)
        depth = jax.random.uniform(
            depth_key, (), minval=self.depth[0], maxval=self.depth[1]
        )
        half_x, half_y = count * width / 2, (depth + length) / 2
        row = jnp.arange(most)
        x, y, yaw = (row + 0.5) * width - half_x, half_y - length / 2, -jnp.pi / 2
        pose = jnp.stack(jnp.broadcast_arrays(x, y, yaw), axis=-1)
        ground = jnp.stack([2 * half_x, depth])
        return assemble(
            jnp.stack([half_x, half_y]),
            bays(pose, (length, width), mask=row < count),
            boundary(half_x, half_y, 0.25, WallKind.WALL),
            spawns_in(DesignCar(), jnp.array([[0.0, -length / 2, 0.0]]), ground[None]),
        )


register_layout("court", CourtConfig())
