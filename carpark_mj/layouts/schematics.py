"""The schematic lots of Tanner 2022 (arXiv 2206.13338): streets and the square.

Schematics (a) and (b), described there but not built: two-way streets with
perpendicular or parallel bays on both sides, one lane each way, walls or kerbs around
everything. Schematic (c): four rows of bays around an open square, no lanes, blocks in
the corners, outer walls. `square` has the paper's proportions, 0.5625 m for a world
unit, and the wall faces of its colliders: corner blocks 9 x 9 and outer walls at 37.5
world units (its drawing has 10 x 10 and 37). `square_compact` has real German bays.
"""

import dataclasses
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import Count, NonNegative
from carpark_mj.layouts import build, standards
from carpark_mj.layouts.base import LayoutConfig, register_layout
from carpark_mj.layouts.standards import DesignCar, Entry
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
        car: the car the street is drawn for.
    """

    parallel: ClassVar[bool] = False
    bays_per_side: standards.Counts = (9, 12)
    bay_width: standards.Lengths = standards.BAY_WIDTH
    bay_length: standards.Lengths = standards.BAY_LENGTH
    aisle_width: standards.Lengths = standards.TWO_WAY_AISLE
    end_length: standards.Lengths = (4.0, 7.0)
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "street"

    def __post_init__(self) -> None:
        super().__post_init__()
        build.require_least(self, self.car.width, "bay_width")
        build.require_least(self, self.car.length, "bay_length")
        least = max(self._entry(0).least(self.car), 2 * build.least_lane(self.car))
        build.require_aisle(self.aisle_width[0], least)

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
        """Draws a street along x."""
        chance = build.chances(key, 5)
        count = build.draw_int(chance[0], self.bays_per_side)
        width = build.draw(chance[1], self.bay_width)
        length = build.draw(chance[2], self.bay_length)
        aisle = build.draw(chance[3], self.aisle_width)
        end = build.draw(chance[4], self.end_length)
        along, across = (length, width) if self.parallel else (width, length)
        row = jnp.arange(self.bays_per_side[1])
        x = (row + 0.5 - count / 2) * along
        y = (aisle + across) / 2
        # Left of the lane along +x, then right of it.
        yaws = (jnp.pi, 0.0) if self.parallel else (-jnp.pi / 2, jnp.pi / 2)
        side, yaw = jnp.array([[1.0], [-1.0]]), jnp.array(yaws)[:, None]
        pose = build.stacked(x, side * y, yaw)
        half_x, half_y = count * along / 2 + end, aisle / 2 + across
        half = jnp.stack([half_x, half_y + standards.WALL_GAP])
        lanes = build.two_lanes(jnp.zeros(3), jnp.stack([2 * half[0], aisle]))
        kind = WallKind.KERB if self.parallel else WallKind.WALL
        return build.assemble(
            half,
            build.bays(pose, jnp.stack([length, width]), mask=row < count),
            build.boundary(half[0], half[1], standards.WALL_THICKNESS, kind),
            *build.driven_lanes(self.car, *lanes),
        )


@dataclasses.dataclass(frozen=True)
class StreetParallelConfig(StreetConfig):
    """Ranges of a street with parallel bays and kerbs around; see `StreetConfig`."""

    parallel: ClassVar[bool] = True
    bays_per_side: standards.Counts = (9, 11)
    bay_width: standards.Lengths = standards.PARALLEL_WIDTH
    bay_length: standards.Lengths = standards.PARALLEL_LENGTH
    family: str = "street_parallel"


OUTER_WALL = 2.0  # m, thickness of a square's outer walls


@dataclasses.dataclass(frozen=True)
class SquareConfig(LayoutConfig):
    """Dimensions of a square lot [m].

    Attributes:
        bays_per_side: bays in each of the four rows.
        bay_width: across a parked car.
        bay_length: along a parked car.
        wall_gap: free strip between the bays' far ends and the outer walls.
        block_inset: free strip about a corner block, towards the rows beside it and
            towards the outer walls' corner.
        spawn_margin: between the open square's edge and the spawn region.
    """

    bays_per_side: Count = 9
    bay_width: NonNegative = 3.375
    bay_length: NonNegative = 5.625
    wall_gap: NonNegative = 0.28125
    block_inset: NonNegative = 0.28125
    spawn_margin: NonNegative = 3.375
    family: str = "square"
    is_random = False

    def __post_init__(self) -> None:
        super().__post_init__()
        car = DesignCar()
        if self.bay_width < car.width or self.bay_length < car.length:
            raise ValueError(
                f"bay_width and bay_length must hold a car of {car.width} m x "
                f"{car.length} m, not {self.bay_width} m x {self.bay_length} m"
            )
        (entry,) = self.entries
        build.require_aisle(entry.aisle, entry.least(car))
        if 2 * self.spawn_margin >= entry.aisle:
            raise ValueError(
                f"spawn_margin {self.spawn_margin} m leaves no spawn region in a "
                f"square of {entry.aisle} m"
            )

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return 4 * self.bays_per_side

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest entry into a bay."""
        return (Entry(self.bays_per_side * self.bay_width, self.bay_width),)

    def generate(self, key: jax.Array) -> Layout:
        """Builds the lot; the key is unused, as nothing is random."""
        del key
        half = self.bays_per_side * self.bay_width / 2
        depth = self.bay_length
        along = (np.arange(self.bays_per_side) + 0.5) * self.bay_width - half
        row = half + depth / 2
        # Bottom, right, top, left; parked cars point at the centre of the lot.
        bay_poses = [(s, -row, math.pi / 2) for s in along]
        bay_poses += [(row, s, -math.pi) for s in along]
        bay_poses += [(s, row, -math.pi / 2) for s in along]
        bay_poses += [(-row, s, 0.0) for s in along]
        thick, block = OUTER_WALL, depth - 2 * self.block_inset
        corner = half + self.block_inset + block / 2
        face = half + depth + self.wall_gap
        middle, span = face + thick / 2, 2 * (face + thick)
        signs = (-1, 1)
        wall_poses = [(x * corner, y * corner, 0.0) for x in signs for y in signs]
        wall_poses += [(0.0, s * middle, 0.0) for s in signs]
        wall_poses += [(s * middle, 0.0, math.pi / 2) for s in signs]
        wall_sizes = [(block, block)] * 4
        wall_sizes += [(span, thick)] * 2 + [(2 * face, thick)] * 2
        side = 2 * (half - self.spawn_margin)
        return build.assemble(
            (face, face),
            build.bays(np.array(bay_poses), (depth, self.bay_width)),
            build.walls(np.array(wall_poses), np.array(wall_sizes)),
            build.spawns([(0.0, 0.0, 0.0)], (side, side), math.pi),
        )


register_layout("square", SquareConfig())
# Bays of 2.50 m x 5.00 m: EAR 23 (Germany), the common perpendicular bay.
SQUARE_COMPACT = register_layout(
    "square_compact",
    SquareConfig(
        bay_width=2.5, bay_length=5.0, wall_gap=0.3, block_inset=0.2, spawn_margin=2.6
    ),
)
register_layout("street", StreetConfig())
register_layout("street_parallel", StreetParallelConfig())
