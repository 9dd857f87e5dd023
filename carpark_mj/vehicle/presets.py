"""Vehicle presets, each number with its source.

[press] manufacturer's data as quoted by motor1 and motor-car.net (Fiat), VW's press
release and stuff.co.nz (Golf), Wikipedia (BMW), autoreviewers and
chicagonow (Camry), laketahoenews (RAV4) and motorblock (T6); [circle] published
kerb-to-kerb circle: carspecslab (Fiat 9.0 to 9.7), 10.9 to 11.1 (Golf), Chrono (E90,
about 11.0), laketahoenews (RAV4, 36.7 ft); [ch] Project Chrono's BMW E90; [fiat]
published weight distribution of 62 % front; [od] openpilot's scaling rule I_zz =
0.2346 m L^2, with I_yy about 0.97 of it and I_xx scaled from [ch]; [est] our estimate
or common knowledge, not looked up.

Masses include a driver. Torque in first gear and power are those of a common engine of
the car; neither limits it at parking speeds. Suspension rates give a ride frequency
of 1.2 to 1.5 Hz and a damping ratio near 0.35, both [est]; `compact` keeps the
defaults, on which published policies were trained.

`SHEETS` are data sheets of more vehicles, whose other parameters are estimated: [press]
as quoted by motor1 (ID.3), autocar (ID.3; S-Class, whose steered rear axle takes 2 m
from the turning circle), more8x (ID.3, kerb mass), newatlas and topgear (Ranger),
benzclub and autoevolution (S-Class), dieselnews (Canter 515 Super Low City Cab) and
krafthand (Canter's wheelbases).
"""

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from carpark_mj.config.checks import Bounds, require_number
from carpark_mj.config.vehicles import is_name
from carpark_mj.extensions import Registry
from carpark_mj.vehicle.parameters import (
    TyreParameters,
    VehicleParameters,
    kerb_to_kerb,
)
from carpark_mj.vehicle.sheet import car_of_sheet, read_vehicle

VEHICLES: Registry[VehicleParameters] = Registry("vehicle")


def register_vehicle(name: str, params: VehicleParameters) -> VehicleParameters:
    """Names a car for `EnvConfig.vehicle`, fleets and flags."""
    return VEHICLES.register(name, params)


def preset(name: str) -> VehicleParameters:
    """The vehicle of a name, or of a file (`carpark_mj.vehicle.sheet`)."""
    return VEHICLES[name] if is_name(name) else read_vehicle(name)[1]


_NAMES = ("city", "compact", "sedan", "sedan_fwd", "suv", "van")
# Fiat 500 (2007); VW Golf VII, the car of all published policies; BMW 320i (E90);
# Toyota Camry (XV50); Toyota RAV4 (2013 to 2018); VW Transporter T6, short wheelbase.
# A source or a note follows the number; numbers without one are [est].
_NUMBERS = {
    "length": (3.546, 4.255, 4.520, 4.805, 4.570, 4.904),  # [press]
    "width": (1.627, 1.799, 1.817, 1.820, 1.845, 1.904),  # [press]
    "height": (1.488, 1.452, 1.421, 1.470, 1.660, 1.970),  # city, compact [press]
    "wheelbase": (2.300, 2.637, 2.760, 2.776, 2.659, 3.000),  # [press]
    "track_width": (1.41, 1.54, 1.505, 1.58, 1.56, 1.63),  # suv [press]
    "rear_overhang": (0.576, 0.76, 1.00, 1.06, 0.99, 0.99),
    # With a driver. city: kerb mass 865 to 980 kg [press]; sedan [ch], chassis and
    # wheels, rounded; suv: 1637 kg [press].
    "mass": (1000.0, 1380.0, 1560.0, 1560.0, 1700.0, 2050.0),
    # city [fiat]; in front 50 % of sedan, 60 of sedan_fwd, 58 of suv, 55 of van, empty.
    "cg_to_front_axle": (0.87, 1.05, 1.38, 1.11, 1.12, 1.35),
    "cg_height": (0.53, 0.54, 0.53, 0.56, 0.65, 0.75),
    "roll_inertia": (310.0, 510.0, 572.0, 606.0, 645.0, 845.0),  # [od]; sedan [ch]
    "pitch_inertia": (1200.0, 2180.0, 2490.0, 2735.0, 2735.0, 4200.0),  # as roll
    "yaw_inertia": (1240.0, 2250.0, 2790.0, 2820.0, 2820.0, 4330.0),  # [od]; [ch] 2768
    # 185/55 R15, 205/55 R16, -, 215/55 R17 [press], 225/65 R17, 215/65 R16 C.
    "wheel_radius": (0.293, 0.316, 0.318, 0.335, 0.362, 0.340),
    "tyre_width": (0.185, 0.205, 0.225, 0.215, 0.225, 0.215),  # sedan_fwd [press]
    # [circle], but sedan_fwd and van.
    "turning_circle": (9.3, 10.9, 11.0, 11.2, 11.2, 11.9),
    # city, compact [press]; suv: coupling closed, as it is when pulling away.
    "front_drive": (1.0, 1.0, 0.0, 1.0, 0.5, 1.0),
    # Torques of 102, 200 [press], 210, 231 [press], 233 and 340 N m times 13.4, 13,
    # 14.3, 12, 12.5 and 14.5.
    "max_drive_torque": (1350.0, 2600.0, 3000.0, 2800.0, 2900.0, 4900.0),
    "max_power": (51e3, 90e3, 125e3, 133e3, 131e3, 110e3),  # compact, sedan_fwd [press]
    "wheel_mass": (15.0, 20.0, 20.0, 20.0, 24.0, 24.0),
    "wheel_inertia": (0.7, 1.0, 1.0, 1.0, 1.6, 1.4),
    "wheel_tilt_inertia": (0.42, 0.6, 0.6, 0.6, 0.95, 0.85),
    "knuckle_mass": (8.0, 10.0, 10.0, 10.0, 12.0, 13.0),
}
_SPRINGS = {
    "vertical_stiffness": (21_000.0, 28_000.0, 30_000.0, 30_000.0, 33_000.0, 38_000.0),
    "vertical_damping": (1600.0, 2200.0, 2400.0, 2400.0, 2600.0, 2900.0),
}


def _car(column: int) -> VehicleParameters:
    numbers = {name: row[column] for name, row in _NUMBERS.items()}
    tyre = TyreParameters(**{name: row[column] for name, row in _SPRINGS.items()})
    return VehicleParameters(**numbers, tyre=tyre)


# Cars with their own looks, to which estimates are fitted. Cars of data sheets, papers
# and other packages are registered too.
PRESETS = MappingProxyType({name: _car(k) for k, name in enumerate(_NAMES)})
CITY, COMPACT = PRESETS["city"], PRESETS["compact"]
for name, params in PRESETS.items():
    register_vehicle(name, params)


_COLUMNS = (
    *("length", "width", "height", "wheelbase", "front_overhang"),
    *("mass", "front_axle_load", "cg_height", "turning_circle", "max_power"),
)
# Numbers are [press] but for those that comments name, which are [est].
_ROWS: dict[str, tuple[tuple[float, ...], dict[str, Any]]] = {
    # VW ID.3, 58 kWh. Overhang, axle load (48 %), the centre of gravity of a car with
    # its battery in the floor, tyres, circle, gear (11.5 times 310 N m) and lag.
    "electric": (
        (4.261, 1.809, 1.568, 2.771, 0.845, 1795.0, 860.0, 0.52, 10.2, 150e3),
        {"tyre_size": "215/55 R18", "drive": "rear"}
        | {"max_drive_torque": 3500.0, "drive_lag": 0.05},
    ),
    # Mercedes-Benz S-Class (W223), long. Overhang, mass, axle load (51 %), centre of
    # gravity, tyres, power, and the circle of 10.9 m to which 2 m are added.
    "limousine": (
        (5.289, 1.921, 1.503, 3.216, 0.88, 2050.0, 1050.0, 0.56, 12.9, 210e3),
        {"tyre_size": "255/50 R18", "drive": "rear"},
    ),
    # Ford Ranger (T6), double cab. Overhang, axle load (57 %, empty), centre of
    # gravity, tyres, track and power.
    "pickup": (
        (5.35, 1.85, 1.85, 3.221, 0.905, 2158.0, 1230.0, 0.72, 12.8, 110e3),
        {"tyre_size": "265/65 R17", "drive": "rear", "track_width": 1.56},
    ),
    # VW Crafter (2017), medium wheelbase, standard roof, with seats; all but the drive
    # (whatvan) and power (kleinezeitung).
    "minibus": (
        (5.986, 2.04, 2.355, 3.64, 0.996, 2700.0, 1490.0, 0.85, 13.6, 103e3),
        {"tyre_size": "205/75 R16 C", "drive": "front", "track_width": 1.75},
    ),
    # Fuso Canter 515 Super Low City Cab with a low, empty body; all but height,
    # wheelbase and power. Body and rear wheels are wider than the cab of 1.695 m.
    "truck": (
        (4.85, 1.77, 2.01, 2.5, 1.045, 2450.0, 1450.0, 0.8, 9.8, 110e3),
        {"tyre_size": "195/75 R16 C", "drive": "rear", "track_width": 1.4},
    ),
}
SHEETS: MappingProxyType[str, dict[str, Any]] = MappingProxyType(
    {name: dict(zip(_COLUMNS, x, strict=True)) | y for name, (x, y) in _ROWS.items()}
)
for name, quantities in SHEETS.items():
    register_vehicle(name, car_of_sheet(quantities).params)


# `range:64` in a fleet stands for 64 cars, from a Smart fortwo to a long Sprinter. They
# are drawn once, evenly and always the same, when an environment is built. Ranges hold
# the data sheets of `carpark_mj.suite.lots`; what these do not say is [est].
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
    return (((name, preset(name)) if is_name(name) else read_vehicle(name)),)


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
    return tuple(_car_at(dict(zip(RANGES, row, strict=True))) for row in rows)


def usual_width(length: float) -> float:
    """Of cars of a length, both in m."""
    return 1.15 + 0.145 * length


def usual_wheels(length: float) -> dict[str, float]:
    """Radius and width of the wheels of cars of a length, all in m [est]."""
    return {"wheel_radius": 0.24 + 0.016 * length, "tyre_width": 0.14 + 0.013 * length}


def _car_at(chance: Mapping[str, float]) -> VehicleParameters:
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
    names = {field.name for field in dataclasses.fields(VehicleParameters)}
    others = names & {*RANGES} - {*quantities}
    quantities |= {name: drawn(name) for name in others}
    # The first quarter of its range is stretched over all of it.
    steers = chance["rear_steering"] / REAR_STEERING
    if length > LONG and steers < 1.0:
        low, high = RANGES["rear_steering"]
        quantities["rear_steering"] = low + steers * (high - low)
    return car_of_sheet(quantities).params
