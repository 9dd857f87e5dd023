"""Identifies a car from the log of a test drive.

carpark_mj identify log.csv --vehicle compact
carpark_mj identify log.csv --vehicle data_sheet.yaml --out my_car.yaml
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Column, Table

from carpark_mj.cli.common import enable_output_fusion, run_command
from carpark_mj.cli.flags import read_flags
from carpark_mj.config.checks import require_finite
from carpark_mj.config.vehicles import is_name
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.identification.fit import (
    PARAMETERS,
    Identification,
    identify,
    place,
    vehicle_text,
)
from carpark_mj.identification.log import DriveLog, read_log
from carpark_mj.vehicle import preset
from carpark_mj.vehicle.sheet import Sheet, read_sheet

PROGRAM = "carpark_mj identify"


@dataclasses.dataclass(frozen=True)
class IdentifyConfig:
    """Settings of `carpark_mj identify`.

    Attributes:
        log: table of the drive, see docs/identify.md.
        vehicle: preset or file of a car like this one.
        out: vehicle file to write.
        ahead: of the rear axle, the point whose x and y are in the log [m].
    """

    log: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="LOG.csv")]
    vehicle: str
    out: str = ""
    ahead: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self, "ahead")
        if self.out and not self.out.endswith((".yaml", ".yml")):
            raise ValueError(f"--out writes a .yaml file, not {self.out}")


def look(config: IdentifyConfig) -> None:
    """Fits the log, prints the table and writes the vehicle file.

    Raises:
        ValueError: an unknown vehicle, a bad file, or a bad log.
        OSError: a file cannot be read or written.
    """
    if config.out:
        require_writable(Path(config.out))
    if is_name(config.vehicle):
        sheet = Sheet(preset(config.vehicle), ())
    else:
        _, sheet = read_sheet(config.vehicle)
    log = read_log(Path(config.log))
    if log.ignored:
        print(f"ignored columns: {', '.join(log.ignored)}")
    found = identify(log, sheet.params, config.ahead)
    if config.out:
        text = vehicle_text(Path(config.out).stem, sheet, found, log)
        write_atomically(Path(config.out), lambda file: file.write_text(text))
    _print(found, log)
    if config.out:
        print(f"wrote {config.out}")


def _print(found: Identification, log: DriveLog) -> None:
    names = "parameter", "value", "95 % interval", "belongs to"
    table = Table(*(Column(name, no_wrap=name != names[-1]) for name in names))
    for name, estimate in found.estimates.items():
        low, high = (estimate.value + s * estimate.error for s in (-1, 1))
        table.add_row(
            name,
            f"{estimate.value:.4g} {PARAMETERS[name].unit}",
            f"{low:.4g} … {high:.4g}" if estimate.identifiable else "not identifiable",
            place(name, log),
        )
    console = Console()
    console.print(table)
    units = {"x": "m", "y": "m", "yaw": "rad", "speed": "m/s", "yaw_rate": "rad/s"}
    residuals = (f"{k} {v:.2g} {units[k]}" for k, v in found.residuals.items())
    print(f"residuals, root mean square: {', '.join(residuals)}")
    for name, estimate in found.estimates.items():
        if not estimate.identifiable:
            needs = PARAMETERS[name].needs
            print(f"{name} keeps the vehicle's value: identify it by {needs}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    enable_output_fusion()

    def command() -> None:
        look(read_flags(IdentifyConfig, arguments, description=__doc__, prog=PROGRAM))

    return run_command("identify", command)
