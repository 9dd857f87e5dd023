"""`carpark_mj layouts`: draws, checks and saves layouts, edits them, imports maps."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from carpark_mj.cli.clock import wait_for_user
from carpark_mj.config import LAYOUTS, LayoutConfig
from carpark_mj.config.checks import Bounds, CheckedConfig, require_unset
from carpark_mj.editor.document import EXTENT, Draft, Picture, read_picture
from carpark_mj.editor.server import EditorServer
from carpark_mj.evaluation.keys import require_seed
from carpark_mj.files import require_suffix, require_writable, write_text
from carpark_mj.layouts import (
    AngledConfig,
    DeadEndConfig,
    DesignCar,
    GarageRowConfig,
    LotConfig,
    layout_config,
)
from carpark_mj.layouts.car_park import crop
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.files import FARTHEST, layout_text
from carpark_mj.layouts.plot import plot_layouts
from carpark_mj.layouts.standards import Level, Orientation
from carpark_mj.layouts.types import Layout
from carpark_mj.rendering.local_pages import HOST, PORT, Port

CHUNK = 250  # layouts drawn at once
Lots = Annotated[int, Bounds(ge=0, le=10_000_000)]  # so many take an hour or more
Crop = tuple[float, float, float, float]  # x and y of two opposite corners [m]
PICTURES = (".png", ".pdf", ".svg")
NUM_DRIVEN = 2  # cars to drive in a scene that is tried out

_LEVELS: dict[Orientation, tuple[Level, ...]] = {
    "perpendicular": ("normal", "complex"),
    "parallel": ("normal", "complex", "extreme"),
}

# Settings with which lots of a family differ most from those with its defaults.
VARIANTS: dict[str, LayoutConfig] = {
    "angled, back-in": AngledConfig(back_in=True, angle=(45.0, 60.0)),
    "lot, deck with pillars": LotConfig(
        pillar_every=3, row_ends="bollards", num_aisles=(1, 3)
    ),
    "lot, angled": LotConfig(
        angle=(50.0, 75.0), two_way=False, extra_aisle=(0.0, 0.6), boundary="kerb"
    ),
    **{
        f"{family}, {orientation}, {level}": config(
            level=level, orientation=orientation
        )
        for family, config in (
            ("garage_row", GarageRowConfig),
            ("dead_end", DeadEndConfig),
        )
        for orientation, levels in _LEVELS.items()
        for level in levels
    },
}


def families() -> dict[str, LayoutConfig]:
    """One layout of every family by its name, and the variants."""
    known: dict[type[LayoutConfig], str] = {}
    for name, config in LAYOUTS.items():
        known.setdefault(type(config), name)
    return {name: LAYOUTS[name] for name in known.values()} | VARIANTS


def draw(layout: LayoutConfig | str, num_keys: int, seed: int) -> Iterator[Layout]:
    """Draws lots of one layout, as numpy arrays; keys are `fold_in(key(seed), k)`."""
    config = layout_config(layout)
    make = jax.jit(jax.vmap(config.generate))
    fold = jax.vmap(jax.random.fold_in, (None, 0))
    chunk = min(CHUNK, num_keys)
    for first in range(0, num_keys, chunk):
        numbers = first + jax.numpy.arange(chunk)
        batch = jax.device_get(make(fold(jax.random.key(seed), numbers)))
        for row in range(min(chunk, num_keys - first)):
            yield jax.tree.map(lambda leaf, row=row: leaf[row], batch)


# What an inspection says of a lot, a sentence each.
Inspect = Callable[[Layout], list[str]]


def faults(layout: LayoutConfig | str, vehicle: str = "") -> Inspect:
    """Problems of a lot's plan with a car.

    Args:
        layout: of which lots are drawn: a name, a file or a config.
        vehicle: a preset or file; by default the lots' design car.
    """
    config = layout_config(layout)
    size = (config.car or DesignCar()).size
    if vehicle:
        from carpark_mj.vehicle import preset

        size = preset(vehicle).length, preset(vehicle).width

    def inspect(drawn: Layout) -> list[str]:
        problems = describe_faults(drawn, size)
        bays = int(drawn.bay_mask.sum())
        if bays < config.min_bays:
            problems.append(f"{bays} bays, min_bays is {config.min_bays}")
        return problems

    return inspect


def out_of_reach(paths: int, seed: int, vehicle: str = "") -> Inspect:
    """Bays that the planner finds no path to.

    Args:
        paths: bays of a lot, drawn at random if it has more.
        seed: seed of the bays drawn and of the searches.
        vehicle: a preset or file; `compact` by default.
    """
    from carpark_mj.planning.search import unreached
    from carpark_mj.vehicle import preset

    def inspect(drawn: Layout) -> list[str]:
        tried, missed = unreached(drawn, preset(vehicle or "compact"), paths, seed)
        bays = ", ".join(map(str, missed))
        words = f"no path found to {len(missed)} of {len(tried)} bays: {bays}"
        return [words] if missed else []

    return inspect


def run_scene(layout: Layout) -> list[str]:
    """MuJoCo's warnings while the scene of one lot runs for a second.

    Every bay holds a parked car; cars to drive stand in the first spawn regions.
    """
    from carpark_mj.scene.build import drivable_scene, try_out
    from carpark_mj.vehicle import COMPACT

    starts = np.asarray(layout.spawn_pose[layout.spawn_mask][:NUM_DRIVEN])
    parked = np.asarray(layout.bay_pose[layout.bay_mask])
    return try_out(drivable_scene(layout, COMPACT, starts, parked))


@dataclasses.dataclass(frozen=True)
class LayoutsConfig(CheckedConfig):
    """Inspects layouts: pictures, files, checks of their plans, runs of their scenes.

    carpark_mj layouts --plot lots.png
    carpark_mj layouts --check 1000 --run 20
    carpark_mj layouts street my_lot.json --check 1000
    carpark_mj layouts my_lot.json --check 1 --paths 20
    carpark_mj layouts lot --seed 3 --save lot.json
    carpark_mj layouts san_jose --crop -40 35 20 65 --save corner.json
    carpark_mj layouts import car_park.osm --out lot.json
    carpark_mj layouts edit lot.json

    Attributes:
        layouts: names or layout files; all families if none.
        plot: picture to write, with two lots of each random layout named, or one of
            every family.
        check: number of lots of each layout to check.
        paths: number of bays of each checked lot, drawn at random, to which the planner
            must find a path; it needs the extra `planner`.
        vehicle: preset or file of the car that must fit into bays and spawn regions of
            the checked lots; by default their design car.
        run: number of scenes of each layout to run.
        save: layout file to write, with the first lot of one layout.
        crop: x and y of two opposite corners [m] of the part to save.
        seed: seed of the keys.
    """

    layouts: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LAYOUT ...")
    ] = ()
    plot: str = ""
    check: Lots = 0
    paths: Lots = 0
    vehicle: str = ""
    run: Lots = 0
    save: str = ""
    crop: Crop | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_seed(self.seed)
        if not (self.plot or self.check or self.run or self.save):
            raise ValueError(
                "nothing to do: give --plot FILE, --save FILE, --check N or --run N "
                "(N > 0)"
            )
        if not self.check:
            require_unset(self, "without --check", "vehicle", "paths")
        if not self.save:
            require_unset(self, "without --save", "crop")
        require_suffix("plot", self.plot, *PICTURES)
        require_suffix("save", self.save, ".json")
        if self.save and len(self.layouts) != 1:
            raise ValueError(
                "--save writes one lot of one layout, not of "
                f"{', '.join(self.layouts) or 'all families'}"
            )


def _save(layout: Layout, part: Crop | None, path: Path, *said: object) -> None:
    """Writes a layout, or a part of it, and prints the file's name."""
    if part is not None:
        layout = crop(layout, part)
    write_text(path, layout_text(layout))
    print(*said, f"wrote {path}: {int(layout.bay_mask.sum())} bays", sep="\n")


def main(config: LayoutsConfig) -> int:
    """Draws, saves, checks and runs; returns the exit code, 1 if there are problems."""
    shown = {name: layout_config(name) for name in config.layouts} or families()
    for file in filter(None, (config.save, config.plot)):
        require_writable(Path(file))  # refused before the work
    if config.save:
        [drawn] = draw(config.layouts[0], 1, config.seed)
        _save(drawn, config.crop, Path(config.save))
    if config.plot:
        pictures = [
            (name, drawn)
            for name, layout in shown.items()
            for drawn in draw(
                layout, 1 + bool(config.layouts and layout.is_random), config.seed
            )
        ]
        print(f"wrote {plot_layouts(pictures, Path(config.plot))}")
    sound = True
    for name, layout in shown.items():
        inspections: list[tuple[Inspect, int, str]] = []
        if config.check:
            inspect = faults(layout, config.vehicle)
            inspections.append((inspect, config.check, "problems"))
        if config.paths:
            inspect = out_of_reach(config.paths, config.seed, config.vehicle)
            inspections.append((inspect, config.check, "with bays out of reach"))
        if config.run:
            inspections.append((run_scene, config.run, "warnings"))
        for inspect, number, what in inspections:
            found = [
                f"key {key}: {problem}"
                for key, drawn in enumerate(draw(layout, number, config.seed))
                for problem in inspect(drawn)
            ]
            sound = sound and not found
            lots = "1 lot" if number == 1 else f"{number} lots"
            print(f"{name}: {lots}, {len(found)} {what}", flush=True)
            print("".join(f"  {problem}\n" for problem in found[:10]), end="")
    return 0 if sound else 1


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
        width: width of the picture [m], instead of `scale`.
        port: port of the page on localhost.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")] = ""
    out: str = ""
    background: str = ""
    scale: Annotated[float, Bounds(ge=0.0, le=FARTHEST, unit="m")] = 0.0
    width: Annotated[float, Bounds(ge=0.0, le=FARTHEST, unit="m")] = 0.0
    port: Port = PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.target:
            raise ValueError("nothing to edit: give FILE.json, or --out for a new lot")
        require_suffix("file", self.file, ".json")
        require_suffix("out", self.out, ".json")
        if not self.background:
            require_unset(self, "without --background", "scale", "width")
        elif bool(self.scale) == bool(self.width):
            raise ValueError(
                "--background takes either --scale in metres per pixel or --width in "
                f"metres, not --scale {self.scale:g} and --width {self.width:g}"
            )

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
        wait_for_user()
        server.serve_forever()


@dataclasses.dataclass(frozen=True)
class ImportConfig:
    """Makes a layout file of a map of a car park; needs the extra `maps`.

    carpark_mj layouts import car_park.osm --out lot.json
    carpark_mj layouts import car_park.geojson --out part.json --crop -20 -10 20 10
    carpark_mj layouts import plan.dxf --out lot.json --unit mm --layer stall=STELLPLATZ

    Attributes:
        map: file to read: Lanelet2 or OpenStreetMap (`.osm`, `.xml`), CommonRoad
            (`.xml`), GeoJSON (`.geojson`, `.json`), a drawing (`.dxf`), or a case of
            ParkBench (`.json`).
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
    crop: Crop | None = None
    level: str | None = None
    crs: str | None = None
    layer: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="WORD=TEXT"),
    ] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        require_suffix("out", self.out, ".json")


def import_layout(config: ImportConfig) -> None:
    """Reads the map, writes the layout file and says what was left out."""
    from carpark_mj.maps.importing import import_map

    require_writable(Path(config.out))
    layout, report = import_map(
        Path(config.map),
        level=config.level,
        crs=config.crs,
        layers=config.layer,
        unit=config.unit,
    )
    _save(layout, config.crop, Path(config.out), report)
