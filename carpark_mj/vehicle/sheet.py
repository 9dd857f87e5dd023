"""A car from the quantities of a data sheet; missing quantities are estimated.

A quantity is a parameter of `VehicleParameters` or a quantity of data sheets that
replaces one (`SHEET`): a number in SI units, or text with a unit, "4,584 mm". Estimates
are fits to `presets.PRESETS`: from outline, wheelbase, mass, drive and wheel they give
a preset's other sizes and inertias within 15 %, its wheels' masses, springs, torque and
power within 35 %.

A data sheet as a YAML or JSON file is a vehicle, too:

    name: my_car
    length: 4.28
    width: 1.79
    wheelbase: 2.64
    mass: 1420
    front_axle_load: 830
    tyre_size: 205/55 R16
    drive: front

Configs hold the parameters as a JSON object in the place of the file's path, so
checkpoints and run folders do not need the file.
"""

import dataclasses
import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from carpark_mj.config.checks import Bounds, is_finite, require_name, require_number
from carpark_mj.reading import parse_object, parse_yaml, read_text
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import (
    LENGTHS,
    TyreParameters,
    VehicleParameters,
    kerb_to_kerb,
)

REQUIRED = ("length", "width", "wheelbase")
# Quantities of data sheets that are no parameters, with what they are.
SHEET = {
    "front_overhang": "front axle to front bumper [m]",
    "track_front": "distance between the front wheels [m]",
    "track_rear": "distance between the rear wheels [m]",
    "kerb_weight": "mass without driver [kg]",
    "front_axle_load": "load of the front axle [kg]",
    "rear_axle_load": "load of the rear axle [kg]",
    "tyre_size": "as on its side, 205/55 R16",
    "tyre_front": "size of the front tyres",
    "tyre_rear": "size of the rear tyres",
    "power": "of the engine [W]",
    "drive": "front, rear or all",
    "steering_ratio": "angle of the steering wheel over that of the front wheels",
    "steering_turns": "turns of the steering wheel from lock to lock",
    "rear_steering": "largest angle of the rear wheels, against the front ones [rad]",
}
DRIVES = {"front": 1.0, "rear": 0.0, "all": 0.5}  # share of the front axle
_PARAMETERS = tuple(field.name for field in dataclasses.fields(VehicleParameters))
_TYRE = tuple(field.name for field in dataclasses.fields(TyreParameters))
_TEXTS = ("tyre_size", "tyre_front", "tyre_rear", "drive")
_MAY_BE_ZERO = ("ackermann", "front_drive", "steering_lag", "drive_lag")
# Width, aspect and rim, perhaps with load and speed: 235/45 R18 98 Y XL.
_TYRE_SIZE = re.compile(r"(\d{3})/(\d{2}) ?Z?R ?(\d{2}(?:\.5)?) ?C?(?: .*)?")
DRIVER = 75.0  # kg, what European kerb masses include
# Units of texts in SI units, and the quantities that have them.
_UNITS = (
    (
        {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048},
        (*LENGTHS, "front_overhang", "track_front", "track_rear"),
    ),
    (
        {"kg": 1.0, "t": 1e3, "lb": 0.45359237},
        ("mass", "kerb_weight", "front_axle_load", "rear_axle_load", "wheel_mass"),
    ),
    ({"W": 1.0, "kW": 1e3, "PS": 735.5, "hp": 745.7}, ("power", "max_power")),
    ({"N m": 1.0, "Nm": 1.0}, ("max_drive_torque",)),
    ({"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704}, ("max_speed", "max_reverse_speed")),
    ({"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180}, ("rear_steering",)),
)
# A number and a unit; "150 kW (204 PS)" says it twice.
_TEXT = re.compile(r"(\d[\d.,'  ]*?)\s*([^\W\d].*?|°)?\s*(?:\(.*\))?")
_THOUSANDS = re.compile(r"[1-9]\d{0,2}(,\d{3})+(\.\d+)?")
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
    """A car of a data sheet."""

    params: VehicleParameters  # its parameters
    # names of parameters estimated from the sheet's quantities. Parameters that are
    # neither here nor in the sheet have the default of all cars.
    estimated: tuple[str, ...]


def car_of_sheet(quantities: Mapping[str, Any]) -> Sheet:
    """The car of quantities of `SHEET` and `VehicleParameters`, `tyre` a mapping.

    Raises:
        ValueError: a quantity is missing, unknown, impossible or contradicts another.
    """
    given = _checked(dict(quantities))
    for convert in (_overhangs, _means, _masses, _tyre_sizes, _drive):
        convert(given)
    tyre, rear_steering = given.pop("tyre", {}), given.pop("rear_steering", None)
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
    if rear_steering is not None:
        _steer_rear(values, rear_steering, "turning_circle" in estimated)
    params = VehicleParameters(**values, tyre=TyreParameters(**tyre))
    chassis_inertial(params)  # refuses wheels that are heavier than the car
    return Sheet(params, tuple(estimated))


def _checked(given: dict[str, Any]) -> dict[str, Any]:
    for name in given:
        require_name("quantity of a car", str(name), (*_PARAMETERS, *SHEET))
    if missing := [name for name in REQUIRED if name not in given]:
        raise ValueError(
            f"{', '.join(missing)} missing: a car needs {', '.join(REQUIRED)}"
        )
    tyre = given.pop("tyre", {})
    if not isinstance(tyre, dict):
        raise ValueError(f"tyre must be an object of {[*_TYRE]}, not {tyre!r}")
    for name in tyre:
        require_name("quantity of a tyre", str(name), _TYRE)
    tyre = {name: _number(f"tyre.{name}", value) for name, value in tyre.items()}
    for name, value in given.items():
        if name not in _TEXTS:
            given[name] = _number(name, value, name in _MAY_BE_ZERO)
        elif not isinstance(value, str):
            raise ValueError(f"{name} must be text ({SHEET[name]}), not {value!r}")
    require_number(
        "wheelbase", given["wheelbase"], Bounds(lt=given["length"], unit="m")
    )
    return {**given, "tyre": tyre}


def _number(name: str, value: Any, zero: bool = False) -> float:
    units = next((units for units, names in _UNITS if name in names), {})
    number = _in_si(value, units) if isinstance(value, str) else value
    if not is_finite(number) or not (number > 0 or (zero and number == 0)):
        least = "of at least 0" if zero else "above 0"
        also = f", also as text with {', '.join(units)}" * bool(units)
        raise ValueError(f"{name} must be a number {least}{also}, not {value!r}")
    return float(number)


def _in_si(text: str, units: Mapping[str, float]) -> float:
    """The number of a text as "1,650 kg"; NaN if it is none."""
    found = _TEXT.fullmatch(text.strip())
    if found is None or found[2] not in (None, *units):
        return math.nan
    digits = re.sub(r"[ ' ]", "", found[1])
    comma = "" if _THOUSANDS.fullmatch(digits) else "."
    try:
        number = float(digits.replace(",", comma)) * units.get(found[2], 1.0)
        return float(f"{number:.12g}")  # 4584 mm are 4.584 m
    except ValueError:
        return math.nan


def _agree(name: str, value: float, other: float, within: float, told: str) -> None:
    """Refuses a value that is farther from another than a share of it."""
    if abs(value - other) > within * other:
        raise ValueError(
            f"{name} {value:g} contradicts {told}, which give {other:.4g} "
            f"(at most {100 * within:g} % apart)"
        )


def _refuse_repeat(given: Mapping[str, Any], name: str, other: str) -> None:
    if name in given:
        raise ValueError(f"{name} {given[name]} repeats {other}: leave one of them out")


def _overhangs(given: dict[str, Any]) -> None:
    front = given.pop("front_overhang", None)
    if front is None:
        return
    both = given["length"] - given["wheelbase"]
    rear = given.setdefault("rear_overhang", both - front)
    require_number("front_overhang", front, Bounds(lt=both, unit="m"))
    whole = given["wheelbase"] + front + rear
    _agree("length", given["length"], whole, 0.01, "wheelbase and overhangs")


def _means(given: dict[str, Any]) -> None:
    """One track for both axles, their mean, and the engine's power."""
    for name, others, within, told in (
        ("track_width", ("track_front", "track_rear"), 0.05, "tracks of the axles"),
        ("max_power", ("power",), 0.3, "the engine's power"),
    ):
        if found := [given.pop(other) for other in others if other in given]:
            mean = sum(found) / len(found)
            _agree(name, given.setdefault(name, mean), mean, within, told)


def _masses(given: dict[str, Any]) -> None:
    kerb = given.pop("kerb_weight", None)
    if kerb is not None:
        _refuse_repeat(given, "mass", "kerb_weight")
        given["mass"] = kerb
    _axle_loads(given)
    if kerb is not None:
        given["mass"] += DRIVER


def _axle_loads(given: dict[str, Any]) -> None:
    front = given.pop("front_axle_load", None)
    rear = given.pop("rear_axle_load", None)
    if front is None and rear is None:
        return
    _refuse_repeat(given, "cg_to_front_axle", "the axle loads")
    if front is not None and rear is not None:
        mass = given.setdefault("mass", front + rear)
        _agree("mass", mass, front + rear, 0.02, "axle loads")
    elif "mass" not in given:
        raise ValueError("an axle load needs mass, or the load of the other axle")
    else:
        mass, load = given["mass"], rear if front is None else front
        require_number("an axle load", load, Bounds(lt=mass, unit="kg"))
        rear = mass - load if rear is None else rear
        front = mass - rear
    given["cg_to_front_axle"] = given["wheelbase"] * rear / (front + rear)


def _tyre_sizes(given: dict[str, Any]) -> None:
    """One radius and width for all wheels: the mean of those of both axles."""
    names = [n for n in ("tyre_size", "tyre_front", "tyre_rear") if n in given]
    if len(names) > 1:
        _refuse_repeat(given, "tyre_size", names[1])
    sizes = [_tyre_size(name, given.pop(name)) for name in names]
    if not sizes:
        return
    told = f"the {' and '.join(names)}"
    radius, width = (sum(x) / len(x) for x in zip(*sizes, strict=True))
    for one in (*(r for r, _ in sizes), given.setdefault("wheel_radius", radius)):
        _agree("wheel_radius", one, radius, 0.06, told)
    _agree("tyre_width", given.setdefault("tyre_width", width), width, 0.1, told)


def _tyre_size(name: str, size: str) -> tuple[float, float]:
    """Radius and width [m]."""
    found = _TYRE_SIZE.fullmatch(size.strip().upper())
    if found is None:
        raise ValueError(f"{name} must be as in 205/55 R16, not {size!r}")
    width, aspect, rim = map(float, found.groups())
    return (rim * _INCH / 2 + width * aspect / 100) / 1000, width / 1000


def _drive(given: dict[str, Any]) -> None:
    if (drive := given.pop("drive", None)) is not None:
        require_name("drive", drive, DRIVES)
        _refuse_repeat(given, "front_drive", "drive")
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
    most = Bounds(lt=steering_ratio / 3, unit="turns, a lock of 60 deg")
    require_number("steering_turns", steering_turns, most)
    circle = _circle(values, lock)
    given = values.setdefault("turning_circle", circle)
    _agree("turning_circle", given, circle, 0.15, "steering ratio and turns")


def _steer_rear(values: dict[str, Any], rear: float, unpublished: bool) -> None:
    """The car without rear steering that turns as one with it.

    Rear wheels that turn against the front ones, in proportion, move the point about
    which the car turns ahead by L tan(rear) / (tan(front) + tan(rear)). A rear axle
    there, with fixed wheels, leads the body on the same path. The published turning
    circle gives the radius R of its middle: ahead by R tan(rear), and
    (L - R tan(rear))^2 + (R + track / 2)^2 is the square of the outer front wheel's.
    """
    if unpublished or not rear < math.pi / 6:
        raise ValueError(
            f"rear_steering {rear:g} rad must be less than 30 deg and needs the "
            "turning_circle with it"
        )
    base, half, tan = values["wheelbase"], values["track_width"] / 2, math.tan(rear)
    outer = (values["turning_circle"] - values["tyre_width"]) / 2
    middle, square = half - base * tan, 1 + tan**2
    root = math.sqrt(middle**2 - square * (base**2 + half**2 - outer**2))
    ahead = tan * (root - middle) / square
    values["wheelbase"] -= ahead
    values["rear_overhang"] += ahead


FORMATS = (".json", ".yaml", ".yml")


def read_sheet(path: str) -> tuple[str, Sheet]:
    """Name and car of a data sheet; `ValueError` if there is a fault."""
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(
            f"a vehicle file must end in one of {', '.join(FORMATS)}, not {path!r}"
        )
    try:
        text = read_text(Path(path))
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    parse = parse_object if suffix == ".json" else parse_yaml
    return _named(parse(text, path), path, Path(path).stem)


def read_as_text(vehicle: str) -> str:
    """The parameters of a file as a JSON object; a JSON object unchanged."""
    return vehicle if vehicle[0] == "{" else parameters_text(*read_vehicle(vehicle))


def parameters_text(name: str, params: VehicleParameters) -> str:
    """All parameters of a car as a JSON object, which is a data sheet, too."""
    return json.dumps({"name": name, **dataclasses.asdict(params)})


def read_vehicle(vehicle: str) -> tuple[str, VehicleParameters]:
    """Name and parameters of a car from the path of a file or a JSON object."""
    if not vehicle.startswith("{"):
        name, sheet = read_sheet(vehicle)
    else:
        name, sheet = _named(parse_object(vehicle, "the vehicle"), "the vehicle", "car")
    return name, sheet.params


def _named(found: dict[str, Any], what: str, default: str) -> tuple[str, Sheet]:
    name = found.pop("name", default)
    try:
        if not isinstance(name, str):
            raise ValueError(f"name must be text, not {name!r}")
        return name, car_of_sheet(found)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from None
