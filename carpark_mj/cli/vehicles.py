"""Shows cars: presets, and data sheets with their estimates.

carpark_mj vehicles
carpark_mj vehicles my_car.yaml
carpark_mj vehicles my_car.yaml --save all_of_it.json
"""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from carpark_mj.cli.common import run_command
from carpark_mj.cli.flags import read_flags
from carpark_mj.config.vehicles import is_name
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.vehicle import VEHICLES, preset
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.sheet import parameters_text, read_sheet

PROGRAM = "carpark_mj vehicles"


@dataclasses.dataclass(frozen=True)
class VehiclesConfig:
    """Settings of `carpark_mj vehicles`.

    Attributes:
        vehicle: a vehicle file or a preset; without one the presets are listed.
        save: file to write all parameters of the vehicle to.
    """

    vehicle: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="VEHICLE")] = ""
    save: str = ""

    def __post_init__(self) -> None:
        if self.save and not (self.vehicle and self.save.endswith(".json")):
            raise ValueError(
                f"--save writes one vehicle to a .json file, not "
                f"{self.vehicle or 'none'} to {self.save}"
            )


def look(config: VehiclesConfig) -> None:
    """Prints and saves.

    Raises:
        ValueError: an unknown vehicle, or a bad file.
        OSError: the file cannot be written.
    """
    if not config.vehicle:
        print("\n".join(VEHICLES))
        return
    if config.save:
        require_writable(Path(config.save))
    name, estimated = config.vehicle, ()
    if is_name(name):
        params = preset(name)
    else:
        name, (params, estimated) = read_sheet(name)
    print("\n".join(_lines(params, estimated)))
    print("metres, kilograms, newtons, watts, seconds, radians")
    if config.save:
        text = json.dumps(json.loads(parameters_text(name, params)), indent=1) + "\n"
        write_atomically(Path(config.save), lambda file: file.write_text(text))
        print(f"wrote {config.save}")


def _lines(params: VehicleParameters, estimated: Sequence[str]) -> list[str]:
    values = dataclasses.asdict(params)
    tyre = values.pop("tyre")
    values |= {f"tyre.{name}": value for name, value in tyre.items()}
    return [
        f"{name:28} {value:<10.4g}{'estimated' * (name in estimated)}".rstrip()
        for name, value in values.items()
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> None:
        look(read_flags(VehiclesConfig, arguments, description=__doc__, prog=PROGRAM))

    return run_command("vehicles", command)
