"""`carpark_mj layouts edit` and `import`: layout files drawn by hand, or from maps."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import tyro

from carpark_mj.config.checks import Bounds, CheckedConfig, require_unset
from carpark_mj.editor.document import EXTENT, Draft, Picture, read_picture
from carpark_mj.editor.server import EditorServer
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.layouts.car_park import crop
from carpark_mj.layouts.files import FARTHEST, layout_text
from carpark_mj.rendering.local_pages import HOST, PORT, check_port


@dataclasses.dataclass(frozen=True)
class EditConfig(CheckedConfig):
    """Draws a lot in the browser and saves it as a layout file.

    carpark_mj layouts edit --out my_lot.json
    carpark_mj layouts edit my_lot.json
    carpark_mj layouts edit --out my_lot.json --background plan.png --width 60

    Attributes:
        file: layout file (`.json`) to edit; an empty lot if not given.
        out: layout file to save to; by default the edited one. Another one must be new.
        background: picture under the drawing (`.png`, `.jpg`, `.webp`), its middle at
            the origin.
        scale: metres per pixel of the picture.
        width: of the picture in metres, instead of `scale`.
        port: of the page on localhost.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")] = ""
    out: str = ""
    background: str = ""
    scale: Annotated[float, Bounds(ge=0.0, le=FARTHEST, unit="m")] = 0.0
    width: Annotated[float, Bounds(ge=0.0, le=FARTHEST, unit="m")] = 0.0
    port: int = PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.target:
            raise ValueError("nothing to edit: give FILE.json, or --out for a new lot")
        for name in filter(None, (self.file, self.target)):
            if not name.endswith(".json"):
                raise ValueError(f"layouts are edited in .json files, not {name}")
        if not self.background:
            require_unset(self, "without --background", "scale", "width")
        elif bool(self.scale) == bool(self.width):
            raise ValueError(
                "--background takes either --scale in metres per pixel or --width in "
                f"metres, not --scale {self.scale:g} and --width {self.width:g}"
            )
        check_port(self.port)

    @property
    def target(self) -> str:
        """The file to save to."""
        return self.out or self.file


def edit(config: EditConfig) -> None:
    """Serves the page until it is interrupted."""
    out, source = Path(config.target), Path(config.file) if config.file else None
    if out.exists() and (source is None or not out.samefile(source)):
        raise ValueError(f"{out} exists: edit it by `carpark_mj layouts edit {out}`")
    picture: Picture | None = None
    if config.background:
        picture = read_picture(Path(config.background), config.scale, config.width)
    require_writable(out)
    extent = EXTENT
    if picture:
        extent = tuple(math.ceil(side) / 2 for side in picture.size)
    draft = Draft(out, source, extent)
    with EditorServer(draft, config.port, picture) as server:
        if draft.kept.exists():
            print(f"opened unsaved changes: {draft.kept}")
        print(f"open http://{HOST}:{server.server_port} (Ctrl-C ends)", flush=True)
        server.serve_forever()


@dataclasses.dataclass(frozen=True)
class ImportConfig:
    """Makes a layout file of a map of a car park; needs the extra `maps`.

    carpark_mj layouts import car_park.osm --out lot.json
    carpark_mj layouts import car_park.geojson --out part.json --crop -20 -10 20 10
    carpark_mj layouts import plan.dxf --out lot.json --unit mm --layer stall=STELLPLATZ

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


def import_layout(config: ImportConfig) -> None:
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
