"""Settings of the car park that `carpark_mj.layouts.lot` draws."""

import dataclasses
import math
from typing import Literal

import numpy as np

from carpark_mj.config import LayoutConfig
from carpark_mj.config.checks import Natural, Range
from carpark_mj.layouts import standards
from carpark_mj.layouts.build import least_lane
from carpark_mj.layouts.ranges import IntRange, require_ranges
from carpark_mj.layouts.standards import (
    ACCESSIBLE_WIDTH,
    FAMILY_WIDTH,
    DesignCar,
    one_way_aisle,
)
from carpark_mj.layouts.street import require_aisle
from carpark_mj.layouts.turning import Entry

RowEnds = Literal["islands", "bollards", "open"]
Boundary = Literal["wall", "kerb"]


@dataclasses.dataclass(frozen=True)
class LotSettings(LayoutConfig):
    """Ranges of a car park; lengths [m].

    Attributes:
        num_aisles: range of the number of aisles.
        bays_per_row: bays of standard width in a row.
        angle: between aisle and bays [deg], 30 to 90.
        two_way: two lanes in each aisle, bays at 90 deg only; otherwise aisles are
            one-way, in alternating directions.
        back_in: angled bays are made for backing in, not for driving in.
        bay_width: across a parked car, standard bays.
        bay_length: along a parked car.
        extra_aisle: width of the aisles beyond the standard's for the angle.
        cross_aisle: width of the cross aisles.
        num_accessible: wide bays for disabled drivers next to the first entrance.
        num_family: wide bays for families after those.
        row_ends: what protects the last cars of a row.
        end_width: of the strip at the ends of the rows.
        pillar_every: bays between pillars, as in a parking deck; 0 = no pillars.
        num_entrances: one, or a second one at the far end.
        boundary: what surrounds the lot.
        wall_thickness: of the boundary.
        car: the car the lot is drawn for.
        family: fixed.
    """

    num_aisles: IntRange = (2, 3)
    bays_per_row: IntRange = (6, 10)
    angle: Range = (90.0, 90.0)
    two_way: bool = True
    back_in: bool = False
    bay_width: Range = standards.BAY_WIDTH
    bay_length: Range = standards.BAY_LENGTH
    extra_aisle: Range = (-1.0, 0.0)
    cross_aisle: Range = standards.TWO_WAY_AISLE
    num_accessible: Natural = 2
    num_family: Natural = 1
    row_ends: RowEnds = "islands"
    end_width: Range = standards.ISLAND_WIDTH
    pillar_every: Natural = 0
    num_entrances: IntRange = (1, 2)
    boundary: Boundary = "wall"
    wall_thickness: standards.Thickness = standards.WALL_THICKNESS
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "lot"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ranges(self, 1, "num_aisles", "bays_per_row", "num_entrances")
        require_ranges(self, 30.0, "angle")
        require_ranges(self, self.car.width, "bay_width")
        require_ranges(self, self.car.length, "bay_length")
        require_ranges(self, 2 * least_lane(self.car), "cross_aisle")
        require_ranges(self, -3.0, "extra_aisle")
        require_ranges(self, 0.1, "end_width")
        if self.angle[1] > 90.0:
            raise ValueError(f"angle must be at most 90 deg, not {self.angle}")
        if self.two_way and self.angle[0] < 90.0:
            raise ValueError(
                f"two_way needs perpendicular bays, angle (90, 90), not {self.angle}"
            )
        if self.num_entrances[1] > 2:
            raise ValueError(f"num_entrances must be 1 or 2, not {self.num_entrances}")
        wide = self.num_accessible * ACCESSIBLE_WIDTH + self.num_family * FAMILY_WIDTH
        if wide > self.bays_per_row[0] * self.bay_width[0]:
            raise ValueError(
                f"num_accessible {self.num_accessible} and num_family "
                f"{self.num_family} need {wide} m, a row may have no more than "
                f"{self.bays_per_row[0] * self.bay_width[0]:.2f} m"
            )
        lane = least_lane(self.car) * (2 if self.two_way else 1)
        for entry in self._entries(self.extra_aisle[0], self.bay_width[0]):
            aisle = entry.aisle
            require_aisle((round(aisle, 3), aisle), max(entry.least(self.car), lane))

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        wide = self.num_accessible * ACCESSIBLE_WIDTH + self.num_family * FAMILY_WIDTH
        low, width = self.bays_per_row[0], self.bay_width[0]
        kept = math.floor((low * width - wide) / width + 1e-6)
        first = self.num_accessible + self.num_family + kept
        return first + (2 * self.num_aisles[0] - 1) * low

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest entries into bays of standard width, by angle."""
        return self._entries(self.extra_aisle[1], self.bay_width[1])

    def _entries(self, extra_aisle: float, bay_width: float) -> tuple[Entry, ...]:
        # Neither the standard nor the least aisle is monotonic between the ends.
        angles = [float(angle) for angle in np.linspace(*self.angle, 25)]
        return tuple(
            Entry(one_way_aisle(a) + extra_aisle, bay_width, a) for a in angles
        )
