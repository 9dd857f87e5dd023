"""The vehicle file of an identified car."""

import dataclasses
from typing import Any

import yaml  # Flax brings it

from carpark_mj.identification.fit import PARAMETERS, Estimate, Identification
from carpark_mj.identification.log import DriveLog
from carpark_mj.vehicle.sheet import Sheet

# Settings of an environment for numbers that a vehicle does not have.
PLACES = {
    "steering_delay": "sim.steering_delay",
    "pedal_delay": "sim.pedal_delay",
    "steering_offset": "randomization.steering_offset",
}


def place(name: str, log: DriveLog) -> str:
    """Where a number of `Sought` belongs."""
    if name == "steering_ratio" and log.names[0] == "steering":
        return "a factor of the log's steering"
    return PLACES.get(name, "vehicle file")


def vehicle_text(name: str, sheet: Sheet, found: Identification, log: DriveLog) -> str:
    """All parameters of a car as YAML, with the origin of each.

    Args:
        name: of the car.
        sheet: the vehicle, which has what the log does not tell.
        found: what the log tells.
        log: the log.
    """
    values = dataclasses.asdict(sheet.params)
    tyre = {f"tyre.{key}": value for key, value in values.pop("tyre").items()}
    origins = dict.fromkeys(sheet.estimated, "estimated")
    lines = [
        "# Identified from the log of a test drive; intervals are at 95 %. What is not",
        "# marked is the vehicle's that was given. Settings of the environment:",
    ]
    for key, estimate in found.estimates.items():
        if place(key, log) != "vehicle file":
            lines.append(f"# {key} {_told(key, estimate)}: {place(key, log)}")
            continue
        full = f"tyre.{key}" if f"tyre.{key}" in tyre else key
        if estimate.told:
            (tyre if full in tyre else values)[full] = estimate.value
            origins[full] = f"identified, {_told(key, estimate)}"
        elif full in values or full in tyre:
            origins[full] = "the log does not tell it"
    lines.append(_line("name", name, ""))
    lines += [_line(key, value, origins.get(key, "")) for key, value in values.items()]
    lines.append("tyre:")
    for key, value in tyre.items():
        part = key.removeprefix("tyre.")
        lines.append("  " + _line(part, value, origins.get(key, "")))
    return "\n".join(lines) + "\n"


def _told(name: str, estimate: Estimate) -> str:
    """A number with its interval."""
    if not estimate.told:
        return "is not told by the log"
    unit = PARAMETERS[name].unit
    return f"{estimate.value:.4g} ± {estimate.error:.2g} {unit}".rstrip()


def _line(key: str, value: Any, origin: str) -> str:
    rounded = float(f"{value:.6g}") if isinstance(value, float) else value
    text = yaml.safe_dump({key: rounded}, allow_unicode=True, width=1000).strip()
    return f"{text}  # {origin}" if origin else text
