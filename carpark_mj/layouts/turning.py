"""The narrowest aisle from which a car can enter a bay, from its turning circle.

A car on full lock turns about a point on its rear axle's line, at R = L / tan(delta)
from the axle's centre (Ackermann). Its inner side sweeps R - w/2; its outer rear and
front corners sweep sqrt((R + w/2)^2 + r^2) and sqrt((R + w/2)^2 + f^2), with r and f
the distances from the rear axle to the bumpers. An aisle is called too narrow if no
single arc on full lock leads from it into a bay between two neighbours; more moves
may succeed, but such bays are not built in practice. This construction underlies the
tables of aisle widths (E. Ricker, The Traffic Design of Parking Garages, 1957), derived
here for oriented boxes. The parallel case is the reverse S-curve of S. Blackburn, The
Geometry of Perfect Parking, 2009.
"""

import dataclasses
import math

from carpark_mj.config.checks import require_within
from carpark_mj.layouts.standards import PLAUSIBLE_BAY, DesignCar


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

    Args:
        car: which car.
        angle: between aisle and bay [deg], in (0, 90].
        bay_width: [m].
        walled: walls stand on the bay's lines; otherwise parked cars of the same size
            stand in the middle of the neighbouring bays, at the aisle's edge.

    Returns:
        The width, or infinity where the car does not fit between the neighbours.
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
class Entry:
    """An entry from an aisle into a bay.

    Attributes:
        aisle: its width [m].
        bay_width: across a parked car [m].
        angle: between aisle and bay [deg], in (0, 90]; 0 = parallel.
        walled: see `least_aisle`.
    """

    aisle: float
    bay_width: float
    angle: float = 90.0
    walled: bool = False

    def __post_init__(self) -> None:
        require_within(self, *PLAUSIBLE_BAY, "m", "bay_width")

    def least(self, car: DesignCar) -> float:
        """Narrowest aisle [m] from which a car can enter the bay."""
        if self.angle == 0.0:
            return least_parallel_aisle(car)
        return least_aisle(car, self.angle, self.bay_width, self.walled)


def least_parallel_aisle(car: DesignCar) -> float:
    """Narrowest aisle [m] beside parallel bays.

    Backing in, the front swings out by Ro - (R + w/2) beyond the car's own width.
    """
    side = car.turning_radius + car.width / 2
    return car.width + math.hypot(side, car.front_reach) - side
