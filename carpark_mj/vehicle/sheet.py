"""A car from the quantities of a data sheet; missing quantities are estimated.

A quantity is a parameter of `VehicleParameters`, in its unit, or a quantity of data
sheets that replaces one (`SHEET`). Estimates are fits to `presets.PRESETS`: from
outline, wheelbase, mass, drive and wheel they give a preset's other sizes and inertias
within 15 %, its wheels' masses, springs, torque and power within 35 %.
"""

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

from carpark_mj.config.checks import is_finite, require_within
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import (
    PLAUSIBLE,
    TyreParameters,
    VehicleParameters,
    kerb_to_kerb,
)

REQUIRED = ("length", "width", "wheelbase")
# Quantities of data sheets that are no parameters, with what they are.
SHEET = {
    "front_overhang": "front axle to front bumper [m]",
    "front_axle_load": "load of the front axle [kg]",
    "rear_axle_load": "load of the rear axle [kg]",
    "tyre_size": "as on its side, 205/55 R16",
    "drive": "front, rear or all",
    "steering_ratio": "angle of the steering wheel over that of the front wheels",
    "steering_turns": "turns of the steering wheel from lock to lock",
}
DRIVES = {"front": 1.0, "rear": 0.0, "all": 0.5}  # share of the front axle
_PARAMETERS = tuple(field.name for field in dataclasses.fields(VehicleParameters))
_TYRE = tuple(field.name for field in dataclasses.fields(TyreParameters))
_TEXTS = ("tyre_size", "drive")
_MAY_BE_ZERO = ("ackermann", "front_drive", "steering_lag", "drive_lag")
_TYRE_SIZE = re.compile(r"(\d{3})/(\d{2}) ?Z?R ?(\d{2}(?:\.5)?) ?C?")
_INCH = 25.4  # mm
_LOCK = 0.61  # rad; the presets have 0.58 to 0.62

# In this order, each from the ones before. Inertias scale as the presets' do.
_ESTIMATES: dict[str, Callable[[Mapping[str, float]], float]] = {
    "height": lambda x: 0.82 * x["width"],
    "wheel_radius": lambda x: min(0.12 * x["wheelbase"], 0.5),
    "tyre_width": lambda x: 0.65 * x["wheel_radius"],
    "track_width": lambda x: x["width"] - x["tyre_width"] - 0.06,
    "rear_overhang": lambda x: 0.5 * (x["length"] - x["wheelbase"]),
    "mass": lambda x: 120.0 * x["length"] * x["width"] * x["height"],
    "front_drive": lambda x: 1.0,
    "cg_to_front_axle": lambda x: (0.5 - 0.1 * x["front_drive"]) * x["wheelbase"],
    "cg_height": lambda x: 0.375 * x["height"],
    "roll_inertia": lambda x: 0.113 * x["mass"] * x["width"] ** 2,
    "yaw_inertia": lambda x: 0.2346 * x["mass"] * x["wheelbase"] ** 2,
    "pitch_inertia": lambda x: 0.97 * x["yaw_inertia"],
    "turning_circle": lambda x: _circle(x, _LOCK),
    "max_drive_torque": lambda x: 5.5 * x["mass"] * x["wheel_radius"],
    "max_power": lambda x: 65.0 * x["mass"],
    "wheel_mass": lambda x: 950.0 * x["tyre_width"] * x["wheel_radius"] ** 2,
    "wheel_inertia": lambda x: 0.51 * x["wheel_mass"] * x["wheel_radius"] ** 2,
    "wheel_tilt_inertia": lambda x: 0.6 * x["wheel_inertia"],
    "knuckle_mass": lambda x: 0.5 * x["wheel_mass"],
}
_TYRE_ESTIMATES: dict[str, Callable[[Mapping[str, float]], float]] = {
    "vertical_stiffness": lambda x: 20.0 * x["mass"],
    "vertical_damping": lambda x: 1.55 * x["mass"],
}


class Sheet(NamedTuple):
    """A car of a data sheet.

    Attributes:
        params: its parameters.
        estimated: names of parameters estimated from the sheet's quantities. Parameters
            that are neither here nor in the sheet have the default of all cars.
    """

    params: VehicleParameters
    estimated: tuple[str, ...]


def car_of_sheet(quantities: Mapping[str, Any]) -> Sheet:
    """The car of a data sheet.

    Args:
        quantities: by name, see `SHEET` and `VehicleParameters`; `tyre` is a mapping of
            `TyreParameters`.

    Raises:
        ValueError: a quantity is missing, unknown, impossible or contradicts another.
    """
    given = _checked(dict(quantities))
    for convert in (_overhangs, _axle_loads, _tyre_size, _drive):
        convert(given)
    tyre = given.pop("tyre", {})
    steering = {name: given.pop(name, None) for name in SHEET if name in given}
    values, estimated = dict(given), []
    for name, estimate in _ESTIMATES.items():
        if name == "turning_circle":
            _steering(values, **steering)
        if name not in values:
            values[name] = estimate(values)
            estimated.append(name)
    for name, estimate in _TYRE_ESTIMATES.items():
        if name not in tyre:
            tyre[name] = estimate(values)
            estimated.append(f"tyre.{name}")
    params = VehicleParameters(**values, tyre=TyreParameters(**tyre))
    chassis_inertial(params)  # refuses wheels that are heavier than the car
    return Sheet(params, tuple(estimated))


def _checked(given: dict[str, Any]) -> dict[str, Any]:
    known = (*_PARAMETERS, *SHEET)
    if unknown := sorted(str(name) for name in given if name not in known):
        raise ValueError(f"unknown {unknown}; a car has {sorted(known)}")
    if missing := [name for name in REQUIRED if name not in given]:
        raise ValueError(
            f"{', '.join(missing)} missing: a car needs {', '.join(REQUIRED)}"
        )
    tyre = given.pop("tyre", {})
    if not isinstance(tyre, dict):
        raise ValueError(f"tyre must be an object of {[*_TYRE]}, not {tyre!r}")
    if unknown := sorted(str(name) for name in tyre if name not in _TYRE):
        raise ValueError(f"unknown {unknown} of tyre; it has {sorted(_TYRE)}")
    tyre = {name: _number(f"tyre.{name}", value) for name, value in tyre.items()}
    for name, value in given.items():
        if name not in _TEXTS:
            given[name] = _number(name, value, name in _MAY_BE_ZERO)
        elif not isinstance(value, str):
            raise ValueError(f"{name} must be text ({SHEET[name]}), not {value!r}")
    for (least, most, unit), names in PLAUSIBLE.items():
        there = [name for name in names if name in given]
        require_within(SimpleNamespace(**given), least, most, unit, *there)
    if not given["wheelbase"] < given["length"]:
        raise ValueError(
            f"wheelbase must be less than the length {given['length']:g} m, not "
            f"{given['wheelbase']:g}"
        )
    return {**given, "tyre": tyre}


def _number(name: str, value: Any, zero: bool = False) -> float:
    if not is_finite(value) or not (value > 0 or (zero and value == 0)):
        least = "of at least 0" if zero else "above 0"
        raise ValueError(f"{name} must be a number {least}, not {value!r}")
    return float(value)


def _agree(name: str, value: float, other: float, within: float, told: str) -> None:
    """Refuses a value that is farther from another than a share of it."""
    if abs(value - other) > within * other:
        raise ValueError(
            f"{name} {value:g} contradicts {told}, which give {other:.4g} "
            f"(at most {100 * within:g} % apart)"
        )


def _overhangs(given: dict[str, Any]) -> None:
    front = given.pop("front_overhang", None)
    if front is None:
        return
    rear = given.setdefault(
        "rear_overhang", given["length"] - given["wheelbase"] - front
    )
    if rear <= 0:
        raise ValueError(
            f"front_overhang must be less than length - wheelbase = "
            f"{given['length'] - given['wheelbase']:.3f} m, not {front:g}"
        )
    _agree(
        "length",
        given["length"],
        given["wheelbase"] + front + rear,
        0.01,
        "wheelbase and overhangs",
    )


def _axle_loads(given: dict[str, Any]) -> None:
    front = given.pop("front_axle_load", None)
    rear = given.pop("rear_axle_load", None)
    if front is None and rear is None:
        return
    if "cg_to_front_axle" in given:
        raise ValueError(
            f"cg_to_front_axle {given['cg_to_front_axle']:g} repeats the axle loads: "
            "leave one of them out"
        )
    if front is not None and rear is not None:
        mass = given.setdefault("mass", front + rear)
        _agree("mass", mass, front + rear, 0.02, "axle loads")
    elif "mass" not in given:
        raise ValueError("an axle load needs mass, or the load of the other axle")
    else:
        name, load = ("front", front) if rear is None else ("rear", rear)
        if not load < given["mass"]:
            raise ValueError(
                f"{name}_axle_load must be less than the mass {given['mass']:g} kg, "
                f"not {load:g}"
            )
        rear = given["mass"] - load if rear is None else rear
        front = given["mass"] - rear
    given["cg_to_front_axle"] = given["wheelbase"] * rear / (front + rear)


def _tyre_size(given: dict[str, Any]) -> None:
    size = given.pop("tyre_size", None)
    if size is None:
        return
    found = _TYRE_SIZE.fullmatch(size.strip().upper())
    if found is None:
        raise ValueError(f"tyre_size must be as in 205/55 R16, not {size!r}")
    width, aspect, rim = map(float, found.groups())
    radius = (rim * _INCH / 2 + width * aspect / 100) / 1000
    told = f"the tyre size {size!r}"
    _agree("wheel_radius", given.setdefault("wheel_radius", radius), radius, 0.06, told)
    _agree(
        "tyre_width",
        given.setdefault("tyre_width", width / 1000),
        width / 1000,
        0.1,
        told,
    )


def _drive(given: dict[str, Any]) -> None:
    drive = given.pop("drive", None)
    if drive is None:
        return
    if drive not in DRIVES:
        raise ValueError(f"unknown drive {drive!r}; choose from {[*DRIVES]}")
    if "front_drive" in given:
        raise ValueError(
            f"front_drive {given['front_drive']:g} repeats drive {drive!r}: "
            "leave one of them out"
        )
    given["front_drive"] = DRIVES[drive]


def _circle(values: Mapping[str, float], steering: float) -> float:
    return kerb_to_kerb(
        values["wheelbase"], values["track_width"], values["tyre_width"], steering
    )


def _steering(
    values: dict[str, Any],
    steering_ratio: float | None = None,
    steering_turns: float | None = None,
) -> None:
    if steering_ratio is None:
        if steering_turns is not None:
            raise ValueError(f"steering_turns {steering_turns:g} needs steering_ratio")
        return
    # [est] a turn of the steering wheel a second; 0.42 rad/s at the usual 15.
    values.setdefault("steering_rate", 2 * math.pi / steering_ratio)
    if steering_turns is None:
        return
    lock = math.pi * steering_turns / steering_ratio
    if not lock < math.pi / 3:
        raise ValueError(
            f"steering_turns must be less than {steering_ratio / 3:.3g} at a "
            f"steering_ratio of {steering_ratio:g}, which is a lock of 60 deg, not "
            f"{steering_turns:g}"
        )
    circle = _circle(values, lock)
    given = values.setdefault("turning_circle", circle)
    _agree("turning_circle", given, circle, 0.15, "steering ratio and turns")
