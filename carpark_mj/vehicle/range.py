"""Cars from a range of data sheets, from a Smart fortwo to a long Sprinter.

`range:64` in a fleet stands for 64 of them. They are drawn once, evenly and always the
same, when an environment is built: each is data like a preset, so their number costs
nothing in a step.

Ranges hold the data sheets of `carpark_mj.suite.lots`. What these do not say is [est].
"""

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping

import numpy as np

from carpark_mj.config.checks import Bounds, require_number
from carpark_mj.config.vehicles import READ, is_name
from carpark_mj.vehicle.parameters import VehicleParameters, kerb_to_kerb
from carpark_mj.vehicle.presets import preset
from carpark_mj.vehicle.sheet import car_of_sheet

_PARAMETERS = [field.name for field in dataclasses.fields(VehicleParameters)]
PREFIX = "range:"  # of a fleet's entry, before the number of cars
MAX_CARS = 1024
LONG = 4.8  # m, from where rear axles may steer
LONGEST_WHEELBASE = 4.6  # m, of the longest vans [est]
REAR_STEERING = 0.25  # share of long cars whose rear axle steers [est]
# Drawn for each car, in this order.
RANGES: Mapping[str, tuple[float, float]] = {
    "length": (2.6, 7.0),  # m
    "width": (-0.17, 0.17),  # m, about a width that grows with the length
    "wheelbase": (0.56, 0.73),  # share of the length
    "rear_overhang": (0.4, 0.62),  # share of both overhangs
    "lock": (0.57, 0.76),  # rad, of the bicycle's wheel
    "height": (0.75, 1.0),  # share of the width
    "mass": (165.0, 255.0),  # kg per m^2 of the outline, with a driver
    "front_drive": (0.0, 1.0),  # thirds: rear-driven, all wheels, front-driven
    "steering_rate": (0.30, 0.60),  # rad/s [est]
    "steering_lag": (0.0, 0.15),  # s [est]
    "drive_lag": (0.0, 0.25),  # s [est] from electric motors to engines
    "max_acceleration": (1.0, 3.0),  # m/s^2 [est]
    "rear_steering": (0.08, 0.17),  # rad
    "max_speed": (2.0, 3.5),  # m/s [est] of parking drivers
    "max_reverse_speed": (1.5, 2.5),  # m/s [est]
}


def cars_of(name: str) -> tuple[tuple[str, VehicleParameters], ...]:
    """The cars that an entry of a fleet stands for, each with its name."""
    if name.startswith(PREFIX):
        number = name.removeprefix(PREFIX)
        if not number.isdecimal():
            raise ValueError(f"{PREFIX}N needs the number of cars, not {name!r}")
        return tuple((name, car) for car in cars_in_range(int(number)))
    return (((name, preset(name)) if is_name(name) else READ.load()(name)),)


def fleet_cars(names: Iterable[str]) -> tuple[tuple[str, VehicleParameters], ...]:
    """The cars of a fleet's entries, one after the other; see `cars_of`."""
    return tuple(car for name in names for car in cars_of(name))


@functools.cache
def cars_in_range(number: int) -> tuple[VehicleParameters, ...]:
    """Cars that cover the range evenly, fixed for a number, at most `MAX_CARS`."""
    require_number("the number of a range's cars", number, Bounds(ge=1, le=MAX_CARS))
    draw = np.random.default_rng(0)  # of a Latin hypercube in (0, 1)
    columns = [(draw.permutation(number) + 0.5) / number for _ in RANGES]
    rows = np.stack(columns, axis=1)
    return tuple(_car(dict(zip(RANGES, row, strict=True))) for row in rows)


def usual_width(length: float) -> float:
    """Of cars of a length, both in m."""
    return 1.15 + 0.145 * length


def usual_wheels(length: float) -> dict[str, float]:
    """Radius and width of the wheels of cars of a length, all in m [est]."""
    return {"wheel_radius": 0.24 + 0.016 * length, "tyre_width": 0.14 + 0.013 * length}


def _car(chance: Mapping[str, float]) -> VehicleParameters:
    """The car at a point of the range."""

    def drawn(name: str) -> float:
        low, high = RANGES[name]
        return low + chance[name] * (high - low)

    length = drawn("length")
    width = min(usual_width(length) + drawn("width"), 2.1)
    wheelbase = min(drawn("wheelbase") * length, LONGEST_WHEELBASE)
    quantities = {
        "length": length,
        "width": width,
        "height": drawn("height") * width,
        "wheelbase": wheelbase,
        "rear_overhang": drawn("rear_overhang") * (length - wheelbase),
        "mass": drawn("mass") * length * width,
        "front_drive": math.floor(3 * chance["front_drive"]) / 2,
        **usual_wheels(length),
    }
    quantities["track_width"] = width - quantities["tyre_width"] - 0.06
    quantities["turning_circle"] = kerb_to_kerb(
        wheelbase, quantities["track_width"], quantities["tyre_width"], drawn("lock")
    )
    # Parameters that are taken as they are drawn.
    others = {*_PARAMETERS} & {*RANGES} - {*quantities}
    quantities |= {name: drawn(name) for name in others}
    # The first quarter of its range is stretched over all of it.
    steers = chance["rear_steering"] / REAR_STEERING
    if length > LONG and steers < 1.0:
        low, high = RANGES["rear_steering"]
        quantities["rear_steering"] = low + steers * (high - low)
    return car_of_sheet(quantities).params
