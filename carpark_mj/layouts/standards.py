"""Dimensions of car parks and of their design car, with sources.

Sources: [mfs] Manual for Streets (UK, 2007), section 8.3; [rast] RASt 06 and EAR 23
(Germany); [us] US practice after the ITE tables, here as in Snohomish Municipal Code
14.235.270 (aisles by angle, 24 ft two-way) and in Portsmouth, Virginia (bays of 9 ft x
18 ft, parallel bays of 8 ft x 22 ft); [din] DIN 18040-1 (accessible bays); [hope] Jiang
et al., HOPE, 2024 (arXiv 2405.20579), levels of difficulty; [est] our estimate. The
figures of [us] and the widths of [rast] were looked up; those of [mfs], [din] and the
lengths of [rast] are from general knowledge of these documents.
"""

import dataclasses
import math
from typing import Annotated, Literal

import numpy as np

from carpark_mj.config.checks import Bounds, CheckedConfig, Positive, Range

FOOT = 0.3048  # m
# Of any bay, in length and width [m]: for a motorcycle and for a lorry with a trailer.
# Beyond, a plan is likely to be in other units.
PLAUSIBLE_BAY: Range = (1.0, 30.0)

BAY_WIDTH: Range = (2.4, 9 * FOOT)  # [mfs] ... [us]; 2.65 m [rast] lies between
BAY_LENGTH: Range = (4.8, 18 * FOOT)  # [mfs] ... [us]; 5.0 m [rast]
PARALLEL_WIDTH: Range = (2.0, 8 * FOOT)  # [rast] ... [us]
PARALLEL_LENGTH: Range = (6.0, 22 * FOOT)  # [mfs] ... [us]
TWO_WAY_AISLE: Range = (6.0, 24 * FOOT)  # [mfs] and [rast] ... [us]
ACCESSIBLE_WIDTH = 3.5  # m [din]
FAMILY_WIDTH = 3.0  # m [est]
ISLAND_WIDTH: Range = (1.2, 1.8)  # m [est]
PILLAR_RADIUS = 0.25  # m [est]
PILLAR_SETBACK = 0.75  # m from the aisle to the pillar, clear of turning cars [est]
PILLAR_CLEARANCE = 0.1  # m between a pillar and the lines beside it [est]
BOLLARD_RADIUS = 0.1  # m [est]
WALL_GAP = 0.3  # m between a bay's far end and the wall behind it [est]
WALL_THICKNESS = 0.25  # m [est]
Thickness = Annotated[float, Bounds(ge=0.01)]  # m, of walls

# Parking angle [deg] and width of a one-way aisle [m]; [us], conventional cars.
AISLE_ANGLES = (30.0, 40.0, 45.0, 50.0, 60.0, 70.0, 80.0, 90.0)
AISLE_WIDTHS = tuple(FOOT * a for a in (11.0, 12.0, 13.5, 15.5, 18.5, 19.5, 24.0, 24.0))


def one_way_aisle(angle: float) -> float:
    """Width [m] of a one-way aisle beside bays at `angle` [deg]; linear in between."""
    return float(np.interp(angle, AISLE_ANGLES, AISLE_WIDTHS))


@dataclasses.dataclass(frozen=True)
class DesignCar(CheckedConfig):
    """The design car of a lot; by default the `compact` vehicle preset.

    Attributes:
        length: [m].
        width: [m].
        wheelbase: [m].
        rear_overhang: rear axle to rear bumper [m].
        max_steering: full lock of the bicycle model's wheel [rad].
    """

    length: Annotated[float, Bounds(ge=1.0, le=25.0, unit="m")] = 4.255
    width: Annotated[float, Bounds(ge=0.5, le=5.0, unit="m")] = 1.799
    wheelbase: Positive = 2.637
    rear_overhang: Positive = 0.76
    max_steering: Annotated[float, Bounds(gt=0.0, lt=math.pi / 2, unit="rad")] = (
        math.radians(34.187)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wheelbase + self.rear_overhang > self.length:
            raise ValueError(
                f"wheelbase {self.wheelbase} m and rear overhang {self.rear_overhang} "
                f"m exceed the car's length of {self.length} m"
            )

    @property
    def size(self) -> tuple[float, float]:
        """Length and width [m]."""
        return self.length, self.width

    @property
    def centre_offset(self) -> float:
        """Rear axle to the footprint's centre [m]."""
        return self.length / 2 - self.rear_overhang

    @property
    def front_reach(self) -> float:
        """Rear axle to front bumper [m]."""
        return self.length - self.rear_overhang

    @property
    def turning_radius(self) -> float:
        """Radius of the rear axle's centre on full lock, L / tan(delta) [m]."""
        return self.wheelbase / math.tan(self.max_steering)


Level = Literal["normal", "complex", "extreme"]
Orientation = Literal["perpendicular", "parallel"]


@dataclasses.dataclass(frozen=True)
class TightBay(CheckedConfig):
    """Room of a hard case beyond the car's own size [m].

    Attributes:
        excess: of the bay over the car, in width (perpendicular) or length (parallel).
        aisle: distance of the wall opposite to the bays.
    """

    excess: Range
    aisle: float


def tight_bay(orientation: Orientation, level: Level, car: DesignCar) -> TightBay:
    """The room of a level of difficulty after [hope].

    Raises:
        ValueError: unknown names, or a level that does not exist for the orientation.
    """
    levels: dict[str, dict[str, TightBay]] = {
        "perpendicular": {
            "normal": TightBay((0.85, 1.2), 7.0),
            "complex": TightBay((0.4, 0.85), 6.0),
        },
        "parallel": {
            "normal": TightBay((0.25 * car.length, 0.25 * car.length + 0.5), 4.5),
            "complex": TightBay((0.9, 0.25 * car.length), 4.0),
            "extreme": TightBay((0.6, 0.9), 3.5),
        },
    }
    if orientation not in levels:
        raise ValueError(
            f"unknown orientation {orientation!r}; choose from {sorted(levels)}"
        )
    if level not in levels[orientation]:
        raise ValueError(
            f"unknown level {level!r} of {orientation} bays; choose from "
            f"{sorted(levels[orientation])}"
        )
    return levels[orientation][level]
