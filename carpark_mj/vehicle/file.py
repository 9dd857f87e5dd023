"""Cars by file: a data sheet as YAML or JSON, and what configs keep of it.

    name: my_car
    length: 4.28
    width: 1.79
    wheelbase: 2.64
    mass: 1420
    front_axle_load: 830
    tyre_size: 205/55 R16
    drive: front

Metres, kilograms, newtons, seconds; `vehicle.sheet` explains the quantities. Configs
hold the parameters as a JSON object in the place of the file's path, so checkpoints and
run folders do not need the file.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

from carpark_mj.reading import parse_object, read_text
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.sheet import Sheet, car_of_sheet

FORMATS = ("json", "yaml", "yml")


def read_sheet(path: str) -> tuple[str, Sheet]:
    """Reads the data sheet of a car.

    Args:
        path: of the file; its suffix says the format.

    Returns:
        The car's name, by default that of the file, and the car.

    Raises:
        ValueError: no such file, or a fault in it.
    """
    suffix = path.rpartition(".")[2].lower()
    if suffix not in FORMATS:
        known = ", ".join(f".{known}" for known in FORMATS)
        raise ValueError(f"a vehicle file must end in one of {known}, not {path!r}")
    try:
        text = read_text(Path(path))
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    parse = parse_object if suffix == "json" else _parse_yaml
    return _named(parse(text, path), path, Path(path).stem)


def read_as_text(vehicle: str) -> str:
    """The parameters of a file as a JSON object; a JSON object unchanged.

    Raises:
        ValueError: no such file, or a fault in it.
    """
    if vehicle.startswith("{"):
        return vehicle
    name, sheet = read_sheet(vehicle)
    return parameters_text(name, sheet.params)


def parameters_text(name: str, params: VehicleParameters) -> str:
    """All parameters of a car as a JSON object, which is a data sheet, too."""
    return json.dumps({"name": name, **dataclasses.asdict(params)})


def read_vehicle(vehicle: str) -> tuple[str, VehicleParameters]:
    """Name and parameters of a car from the path of a file or a JSON object.

    Raises:
        ValueError: no such file, or a fault in it or in the object.
    """
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


def _parse_yaml(text: str, what: str) -> dict[str, Any]:
    """Parses the YAML mapping of a file."""
    import yaml  # only for such files; Flax brings it

    try:
        tree = yaml.compose(text, Loader=yaml.SafeLoader)
        found = yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ValueError(f"{what}, line {line}: not YAML ({error.problem})") from None
    except (yaml.YAMLError, ValueError) as error:  # characters, dates
        told = " ".join(str(error).split())
        raise ValueError(f"{what}: not YAML ({told})") from None
    except RecursionError:
        raise ValueError(f"{what} is nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError(f"{what} must have lines as 'length: 4.28', not {text[:40]!r}")
    names = [key.value for key, _ in tree.value]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"{what} has {', '.join(twice)} twice")
    return found
