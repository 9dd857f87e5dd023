"""Tight bays between walls: the hard cases of the parking literature.

The levels of difficulty are those of HOPE (Jiang et al. 2024, arXiv 2405.20579); see
`standards.tight_bay`.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import Group, lanes, spawns_in
from carpark_mj.layouts.ranges import draw
from carpark_mj.layouts.standards import (
    DesignCar,
    Level,
    Orientation,
    TightBay,
    tight_bay,
)
from carpark_mj.layouts.street import require_aisle
from carpark_mj.layouts.turning import Entry


@dataclasses.dataclass(frozen=True)
class TightConfig(LayoutConfig):
    """Base of the families with tight bays; lengths [m].

    Attributes:
        level: how much room there is.
        orientation: of the bays to the aisle.
        wall_thickness: of all walls.
        car: the car the lot is drawn for; the room is measured from its size.
    """

    level: Level = "normal"
    orientation: Orientation = "perpendicular"
    wall_thickness: standards.Thickness = standards.WALL_THICKNESS
    car: DesignCar = dataclasses.field(default_factory=DesignCar)

    def __post_init__(self) -> None:
        super().__post_init__()
        entry = self._entry(0)
        require_aisle((entry.aisle, entry.aisle), entry.least(self.car))

    @property
    def room(self) -> TightBay:
        """The room that the level leaves; an unknown name is a ValueError."""
        return tight_bay(self.orientation, self.level, self.car)

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

    Returns:
        (2,) length and width, (2,) extent along and across the aisle [m], and the
        heading of bays on the left of an aisle along +x [rad].
    """
    excess = draw(chance[0], config.room.excess)
    if config.orientation == "parallel":
        width = draw(chance[1], standards.PARALLEL_WIDTH)
        size = jnp.stack([config.car.length + excess, width])
        return size, size, 0.0
    length = draw(chance[1], standards.BAY_LENGTH)
    size = jnp.stack([length, config.car.width + excess])
    return size, size[::-1], -jnp.pi / 2


def two_way_aisle(
    car: DesignCar, length: jax.Array, y: jax.Array, width: float
) -> tuple[Group, Group]:
    """An undivided aisle along x about x = 0, and spawn regions for both directions."""
    size = jnp.stack([length, jnp.float32(width)])
    pose = jnp.stack(
        [
            jnp.stack([jnp.zeros_like(y), y, jnp.full_like(y, yaw)])
            for yaw in (0, jnp.pi)
        ]
    )
    return lanes(pose[:1], size, one_way=False), spawns_in(car, pose, size)
