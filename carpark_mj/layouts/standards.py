"""Dimensions of car parks and of their design car, with sources.

Sources: [mfs] Manual for Streets (UK, 2007), section 8.3; [rast] RASt 06 and EAR 23
(Germany); [us] US practice after the ITE tables, here as in Snohomish Municipal Code
14.235.270 (aisles by angle, 24 ft two-way) and in Portsmouth, Virginia (bays of 9 ft x
18 ft, parallel bays of 8 ft x 22 ft); [din] DIN 18040-1 (accessible bays); [hope] Jiang
et al., HOPE, 2024 (arXiv 2405.20579), levels of difficulty; [est] our estimate. The
figures of [us] and the widths of [rast] were looked up; those of [mfs], [din] and the
lengths of [rast] are from general knowledge of these documents.

The narrowest aisle from which a car can enter a bay follows from its turning circle. On
full lock a car turns about a point on its rear axle's line, at R = L / tan(delta) from
the axle's centre (Ackermann). Its inner side sweeps R - w/2; its outer rear and front
corners sweep sqrt((R + w/2)^2 + r^2) and sqrt((R + w/2)^2 + f^2), with r and f the
distances from the rear axle to the bumpers. An aisle is called too narrow if no single
arc on full lock leads from it into a bay between two neighbours; more moves may
succeed, but such bays are not built in practice. This construction underlies the tables
of aisle widths (E. Ricker, The Traffic Design of Parking Garages, 1957), derived here
for oriented boxes. The parallel case is the reverse S-curve of S. Blackburn, The
Geometry of Perfect Parking, 2009.
"""

import dataclasses
import math
from typing import Annotated, Literal, NamedTuple

import numpy as np

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    IntRange,
    Positive,
    Range,
    require_name,
)

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

# Types of settings; ranges of lengths [m].
Counts = Annotated[IntRange, Bounds(ge=1)]
Lengths = Annotated[Range, Bounds(ge=0.0, unit="m")]

# Parking angle [deg] and width of a one-way aisle [m]; [us], conventional cars.
AISLE_ANGLES = (30.0, 40.0, 45.0, 50.0, 60.0, 70.0, 80.0, 90.0)
AISLE_WIDTHS = tuple(FOOT * a for a in (11.0, 12.0, 13.5, 15.5, 18.5, 19.5, 24.0, 24.0))
Level = Literal["normal", "complex", "extreme"]
Orientation = Literal["perpendicular", "parallel"]


def one_way_aisle(angle: float) -> float:
    """Width [m] of a one-way aisle beside bays at `angle` [deg]; linear in between."""
    return float(np.interp(angle, AISLE_ANGLES, AISLE_WIDTHS))


@dataclasses.dataclass(frozen=True)
class DesignCar(CheckedConfig):
    """The design car of a lot in metres; by default the `compact` vehicle preset.

    `max_steering` is the full lock of the bicycle model's wheel [rad].
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


class TightBay(NamedTuple):
    """Room of a hard case beyond the car's own size [m]."""

    excess: Range  # of the bay, in width (perpendicular) or length (parallel)
    aisle: float  # from the wall opposite to the bays


def tight_bay(orientation: Orientation, level: Level, car: DesignCar) -> TightBay:
    """The room of a level of difficulty after [hope]."""
    quarter = 0.25 * car.length
    levels: dict[str, dict[str, TightBay]] = {
        "perpendicular": {
            "normal": TightBay((0.85, 1.2), 7.0),
            "complex": TightBay((0.4, 0.85), 6.0),
        },
        "parallel": {
            "normal": TightBay((quarter, quarter + 0.5), 4.5),
            "complex": TightBay((0.9, quarter), 4.0),
            "extreme": TightBay((0.6, 0.9), 3.5),
        },
    }
    require_name(f"level of {orientation} bays", level, levels[orientation])
    return levels[orientation][level]


def least_aisle(car: DesignCar, angle: float, bay_width: float, walled: bool) -> float:
    """Narrowest aisle [m] from which one arc leads into a bay.

    Bays at an angle are entered forwards; perpendicular ones in reverse if that needs
    less. With q^2 = (R - w/2)^2 - (R - b)^2 and s^2 = Ro^2 - (R + b)^2, where b is the
    distance from the bay's axis to its neighbours and Ro the front corner's radius, the
    inner side clears the inner neighbour's corner (at -i along the bay's axis) if the
    arc ends with the rear axle at most q - i beyond the aisle's edge, and the front
    corner clears the outer neighbour's (at +o) if it ends s before that. Forwards, the
    outer rear corner then sweeps Rr - (end sin(angle) + R cos(angle)) of the aisle; in
    reverse the front corner sweeps Ro - q.

    The angle between aisle and bay is in (0, 90] deg. If `walled`, walls stand on the
    bay's lines; otherwise parked cars of the same size stand in the middle of the
    neighbouring bays, at the aisle's edge. Infinity where the car does not fit between.
    """
    radius, half_width = car.turning_radius, car.width / 2
    beside = bay_width / 2 if walled else bay_width - half_width
    if beside < half_width:
        return math.inf
    theta = math.radians(angle)
    cot = 1.0 / math.tan(theta)
    inner_corner = -0.5 * bay_width * cot
    outer_corner = 0.5 * bay_width * cot if walled else 1.5 * bay_width * cot
    inner = radius - half_width
    q = math.sqrt(max(inner**2 - max(radius - beside, 0.0) ** 2, 0.0))
    front = math.hypot(radius + half_width, car.front_reach)
    rear = math.hypot(radius + half_width, car.rear_overhang)
    s = math.sqrt(max(front**2 - (radius + beside) ** 2, 0.0))
    end = min(inner_corner + q, outer_corner - s)
    forwards = rear - (end * math.sin(theta) + radius * math.cos(theta))
    forwards = max(forwards, car.width)
    if angle < 90.0:
        return forwards
    # In reverse the outer rear corner must pass the outer neighbour.
    reverse = front - q if rear <= radius + beside else math.inf
    return min(forwards, max(reverse, car.width))


@dataclasses.dataclass(frozen=True)
class Entry(CheckedConfig):
    """An entry from an aisle into a bay."""

    aisle: float  # its width [m]
    # across a parked car
    bay_width: Annotated[float, Bounds(ge=1.0, le=30.0, unit="m")]
    angle: float = 90.0  # between aisle and bay [deg], in (0, 90]; 0 = parallel
    walled: bool = False  # see `least_aisle`

    def least(self, car: DesignCar) -> float:
        """Narrowest aisle [m] from which a car can enter the bay."""
        if self.angle == 0.0:
            return least_parallel_aisle(car)
        return least_aisle(car, self.angle, self.bay_width, self.walled)


def least_parallel_aisle(car: DesignCar) -> float:
    """Narrowest aisle [m] beside parallel bays: a car that backs in swings out."""
    side = car.turning_radius + car.width / 2
    return car.width + math.hypot(side, car.front_reach) - side
