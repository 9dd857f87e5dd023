"""`carpark_mj vehicles` and `identify`: parameters of cars, of files and of drives."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from carpark_mj.cli.settings.lots import IdentifyConfig, VehiclesConfig
from carpark_mj.config.vehicles import is_name
from carpark_mj.evaluation.tables import print_rows
from carpark_mj.files import require_writable, write_text
from carpark_mj.identification import fit as fitting
from carpark_mj.identification.log import DriveLog, read_log
from carpark_mj.vehicle import preset
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.sheet import Sheet, parameters_text, read_sheet


def show(config: VehiclesConfig) -> None:
    """Prints and saves."""
    if config.save:
        require_writable(Path(config.save))
    name, (params, estimated) = _sheet(config.vehicle)
    print("\n".join(_lines(params, estimated)))
    print("metres, kilograms, newtons, watts, seconds, radians")
    if config.save:
        text = json.dumps(json.loads(parameters_text(name, params)), indent=1) + "\n"
        write_text(Path(config.save), text)
        print(f"wrote {config.save}")


def _sheet(vehicle: str) -> tuple[str, Sheet]:
    """Name and data sheet of a preset or a file."""
    if is_name(vehicle):
        return vehicle, Sheet(preset(vehicle), ())
    return read_sheet(vehicle)


def _lines(params: VehicleParameters, estimated: Sequence[str]) -> list[str]:
    values = dataclasses.asdict(params)
    tyre = values.pop("tyre")
    values |= {f"tyre.{name}": value for name, value in tyre.items()}
    return [
        f"{name:28} {value:<10.4g}{'estimated' * (name in estimated)}".rstrip()
        for name, value in values.items()
    ]


def fit(config: IdentifyConfig) -> None:
    """Fits the log, prints the table and writes the vehicle file."""
    if config.out:
        require_writable(Path(config.out))
    _, sheet = _sheet(config.vehicle)
    log = read_log(Path(config.log))
    if log.ignored:
        print(f"ignored columns: {', '.join(log.ignored)}")
    found = fitting.identify(log, sheet.params, config.ahead)
    if config.out:
        text = fitting.vehicle_text(Path(config.out).stem, sheet, found, log)
        write_text(Path(config.out), text)
    _print(found, log)
    if config.out:
        print(f"wrote {config.out}")


def _print(found: fitting.Identification, log: DriveLog) -> None:
    rows = []
    for name, estimate in found.estimates.items():
        low, high = (estimate.value + s * estimate.error for s in (-1, 1))
        interval = f"{low:.4g} … {high:.4g}"
        row = {"parameter": name}
        row["value"] = f"{estimate.value:.4g} {fitting.PARAMETERS[name].unit}"
        row["95 % interval"] = interval if estimate.identifiable else "not identifiable"
        rows.append(row | {"belongs to": fitting.place(name, log)})
    print_rows(rows)
    units = {"x": "m", "y": "m", "yaw": "rad", "speed": "m/s", "yaw_rate": "rad/s"}
    residuals = (f"{k} {v:.2g} {units[k]}" for k, v in found.residuals.items())
    print(f"residuals, root mean square: {', '.join(residuals)}")
    for name, estimate in found.estimates.items():
        if not estimate.identifiable:
            needs = fitting.PARAMETERS[name].needs
            print(f"{name} keeps the vehicle's value: identify it by {needs}")
