"""Rows of angled bays on one-way aisles, nose-in or back-in."""

import dataclasses

import jax

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.config.checks import Range
from carpark_mj.layouts import standards
from carpark_mj.layouts.lot import LotConfig
from carpark_mj.layouts.ranges import IntRange
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.turning import Entry
from carpark_mj.layouts.types import Layout


@dataclasses.dataclass(frozen=True)
class AngledConfig(LayoutConfig):
    """Ranges of a lot with angled bays; lengths [m].

    Attributes:
        num_aisles: range of the number of aisles; they alternate in direction.
        bays_per_row: bays in a row.
        angle: between aisle and bays [deg], 30 to 75.
        back_in: bays are made for backing in, not for driving in.
        bay_width: across a parked car.
        bay_length: along a parked car.
        extra_aisle: width of the aisles beyond the standard's for the angle.
        cross_aisle: width of the cross aisles.
        car: the car the lot is drawn for.
        family: fixed.
    """

    num_aisles: IntRange = (1, 2)
    bays_per_row: IntRange = (9, 12)
    angle: Range = (30.0, 75.0)
    back_in: bool = False
    bay_width: Range = standards.BAY_WIDTH
    bay_length: Range = standards.BAY_LENGTH
    extra_aisle: Range = (0.0, 0.6)
    cross_aisle: Range = standards.TWO_WAY_AISLE
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "angled"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.as_lot()
        if self.angle[1] > 75.0:
            raise ValueError(f"angle must lie within 30 to 75 deg, not {self.angle}")

    def as_lot(self) -> LotConfig:
        """The same as a lot's config; raises ValueError if it is impossible."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        del fields["family"]
        return LotConfig(
            **fields,
            two_way=False,
            num_accessible=0,
            num_family=0,
            num_entrances=(1, 1),
        )

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return self.as_lot().min_bays

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest entries into bays, by angle."""
        return self.as_lot().entries

    def generate(self, key: jax.Array) -> Layout:
        """Draws a lot of angled bays."""
        return self.as_lot().generate(key)


register_layout("angled", AngledConfig())
