"""Makes a layout file of a map of a car park; needs the extra `maps`.

carpark_mj layouts import car_park.osm --out lot.json
carpark_mj layouts import car_park.geojson --out part.json --crop -20 -10 20 10
carpark_mj layouts import plan.dxf --out lot.json --unit mm --layer stall=STELLPLATZ
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from carpark_mj.cli.common import run_command
from carpark_mj.cli.flags import read_flags
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.layouts.car_park import crop
from carpark_mj.layouts.files import layout_text

PROGRAM = "carpark_mj layouts import"


@dataclasses.dataclass(frozen=True)
class ImportConfig:
    """Settings of `carpark_mj layouts import`.

    Attributes:
        map: file to read: Lanelet2 or OpenStreetMap (`.osm`, `.xml`), CommonRoad
            (`.xml`), GeoJSON (`.geojson`, `.json`), or a drawing (`.dxf`).
        out: layout file to write.
        crop: x and y of two opposite corners [m] of the part to take, in the frame of
            the whole lot.
        level: of a car park with several, as the map names it; the one with most spots
            by default.
        crs: coordinate reference system of a GeoJSON file that does not name its own,
            such as EPSG:25832.
        layer: of a drawing, WORD=TEXT: the layers whose names contain the text hold
            stalls, aisles, walls, kerbs, columns, drivable ground or starts; may be
            repeated.
        unit: of a drawing without one, or with a wrong one: mm, cm, m, in or ft.
    """

    map: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    out: str
    crop: tuple[float, float, float, float] | None = None
    level: str | None = None
    crs: str | None = None
    layer: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="WORD=TEXT"),
    ] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.out.endswith(".json"):
            raise ValueError(f"--out writes a .json file, not {self.out}")


def make(config: ImportConfig) -> None:
    """Reads the map, writes the layout file and says what was left out."""
    require_writable(Path(config.out))
    try:
        from carpark_mj.maps.importing import import_map

        layout, report = import_map(
            Path(config.map),
            level=config.level,
            crs=config.crs,
            layers=config.layer,
            unit=config.unit,
        )
    except ImportError as error:  # each format imports its own
        raise ValueError(
            f"maps need {error.name}: pip install 'carpark_mj[maps]'"
        ) from None
    if config.crop is not None:
        layout = crop(layout, config.crop)
    text = layout_text(layout)
    write_atomically(Path(config.out), lambda file: file.write_text(text))
    print(report)
    print(f"wrote {config.out}: {int(layout.bay_mask.sum())} bays")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> int:
        make(read_flags(ImportConfig, arguments, description=__doc__, prog=PROGRAM))
        return 0

    return run_command("layouts import", command)
