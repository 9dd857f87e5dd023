"""Settings of the commands about cars and layouts, and of `list`."""

import dataclasses
from typing import Annotated, Literal

import tyro

from carpark_mj.config.checks import (
    FARTHEST,
    Bounds,
    CheckedConfig,
    Finite,
    Seed,
    require_unset,
)
from carpark_mj.files import require_suffix
from carpark_mj.rendering.local_pages import PORT, Port

Lots = Annotated[int, Bounds(ge=0, le=10_000_000)]  # so many take an hour or more
Crop = tuple[float, float, float, float]  # x and y of two opposite corners [m]
Names = Annotated[tuple[str, ...], tyro.conf.Positional]
PICTURES = (".png", ".pdf", ".svg")
Kind = Literal["all", "layouts", "environments", "vehicles", "policies", "presets"]


@dataclasses.dataclass(frozen=True)
class ListConfig:
    """Lists names, also those of installed extensions.

    carpark_mj list
    carpark_mj list layouts

    Attributes:
        kind: what to list; everything if not given.
    """

    kind: Annotated[Kind, tyro.conf.Positional] = "all"


@dataclasses.dataclass(frozen=True)
class VehiclesConfig:
    """Shows a car: a preset, or a data sheet with its estimates.

    carpark_mj vehicles my_car.yaml
    carpark_mj vehicles my_car.yaml --save whole.json

    Attributes:
        vehicle: a vehicle file, or a preset of `carpark_mj list vehicles`.
        save: file to write all parameters of the vehicle to.
    """

    vehicle: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="VEHICLE")]
    save: str = ""

    def __post_init__(self) -> None:
        require_suffix("save", self.save, ".json")


@dataclasses.dataclass(frozen=True)
class IdentifyConfig(CheckedConfig):
    """Identifies a car from the log of a test drive.

    carpark_mj identify log.csv --vehicle compact
    carpark_mj identify log.csv --vehicle data_sheet.yaml --out my_car.yaml

    Attributes:
        log: table of the drive, see the documentation's page on identification.
        vehicle: preset or file of a car like this one.
        out: vehicle file to write.
        ahead: distance from the rear axle to the point whose x and y are logged,
            forwards positive [m].
    """

    log: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="LOG.csv")]
    vehicle: str
    out: str = ""
    ahead: Finite = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_suffix("out", self.out, ".yaml", ".yml")


@dataclasses.dataclass(frozen=True)
class LayoutsConfig(CheckedConfig):
    """Inspects layouts: pictures, files, checks of their plans.

    carpark_mj layouts --plot lots.png
    carpark_mj layouts --check 1000
    carpark_mj layouts street my_lot.json --check 1000
    carpark_mj layouts my_lot.json --check 1 --paths 20
    carpark_mj layouts clutter_tight --check 200 --paths 1
    carpark_mj layouts lot --seed 3 --save lot.json
    carpark_mj layouts san_jose --crop -40 35 20 65 --save corner.json
    carpark_mj layouts edit lot.json

    Attributes:
        layouts: names or layout files; all families if none.
        plot: picture of two lots of each random layout named, or one of every family.
        check: number of lots of each layout to check.
        paths: number of bays of each checked lot, drawn at random, to which the planner
            must find a path, with the rate of lots where it does and Wilson's interval
            of 95 %; it needs the extra `planner`.
        vehicle: preset or file of the car that must fit into bays and spawn regions of
            the checked lots; by default their design car.
        save: layout file (`.json`) to write, with the first lot of one layout, or a
            file of another program if an extension has its suffix.
        crop: x and y of two opposite corners [m] of the part to save.
        seed: seed of the keys.
    """

    layouts: Annotated[Names, tyro.conf.arg(metavar="LAYOUT ...")] = ()
    plot: str = ""
    check: Lots = 0
    paths: Lots = 0
    vehicle: str = ""
    save: str = ""
    crop: Crop | None = None
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.plot or self.check or self.save):
            raise ValueError(
                "nothing to do: give --plot, --save or --check; `carpark_mj list "
                "layouts` has the names"
            )
        if not self.check:
            require_unset(self, "without --check", "vehicle", "paths")
        if not self.save:
            require_unset(self, "without --save", "crop")
        require_suffix("plot", self.plot, *PICTURES)
        if self.save and len(self.layouts) != 1:
            raise ValueError(
                "--save writes one lot of one layout, not of "
                f"{', '.join(self.layouts) or 'all families'}"
            )


@dataclasses.dataclass(frozen=True)
class EditConfig(CheckedConfig):
    """Draws a lot in the browser and saves it as a layout file.

    carpark_mj layouts edit --out my_lot.json
    carpark_mj layouts edit my_lot.json
    carpark_mj layouts edit --out my_lot.json --background plan.png --width 60

    Attributes:
        file: layout file (`.json`) to edit; an empty lot if not given.
        out: layout file to save to; by default the edited one. Another one must be new.
        background: picture centred at the origin (`.png`, `.jpg`, `.webp`).
        width: width of the picture [m].
        port: port of the page on localhost.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")] = ""
    out: str = ""
    background: str = ""
    width: Annotated[float, Bounds(ge=0.0, le=FARTHEST, unit="m")] = 0.0
    port: Port = PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.target:
            raise ValueError("nothing to edit: give FILE.json, or --out for a new lot")
        require_suffix("file", self.file, ".json")
        require_suffix("out", self.out, ".json")
        if bool(self.background) != bool(self.width):
            raise ValueError("--background and --width, in metres, belong together")

    @property
    def target(self) -> str:
        """The file to save to."""
        return self.out or self.file
