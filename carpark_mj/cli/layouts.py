"""`carpark_mj layouts`: draws, plots, checks, runs and saves layouts."""

import dataclasses
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from carpark_mj.config import LAYOUTS, LayoutConfig
from carpark_mj.config.checks import Bounds, CheckedConfig, require_unset
from carpark_mj.evaluation.keys import require_seed
from carpark_mj.files import require_writable, write_atomically
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
from carpark_mj.layouts.files import layout_text
from carpark_mj.layouts.plot import plot_layouts
from carpark_mj.layouts.standards import Level, Orientation
from carpark_mj.layouts.types import Layout

CHUNK = 250  # layouts drawn at once
Lots = Annotated[int, Bounds(ge=0, le=10_000_000)]  # so many take an hour or more
PICTURES = (".png", ".pdf", ".svg")
NUM_DRIVEN = 2  # cars to drive in a scene that is tried out

_LEVELS: tuple[tuple[Orientation, Level], ...] = (
    ("perpendicular", "normal"),
    ("perpendicular", "complex"),
    ("parallel", "normal"),
    ("parallel", "complex"),
    ("parallel", "extreme"),
)

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
        for orientation, level in _LEVELS
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


def check(
    layout: LayoutConfig | str, num_keys: int, seed: int, vehicle: str = ""
) -> list[str]:
    """Problems of the lots of `num_keys` keys with a car, a sentence each.

    Args:
        layout: a name, a file or a config.
        num_keys: how many.
        seed: of the keys.
        vehicle: a preset or file; by default the lots' design car.
    """
    config = layout_config(layout)
    size = (config.car or DesignCar()).size
    if vehicle:
        from carpark_mj.vehicle import preset

        size = preset(vehicle).length, preset(vehicle).width
    found = []
    for number, drawn in enumerate(draw(config, num_keys, seed)):
        problems = describe_faults(drawn, size)
        bays = int(drawn.bay_mask.sum())
        if bays < config.min_bays:
            problems.append(f"{bays} bays, min_bays is {config.min_bays}")
        found += [f"key {number}: {problem}" for problem in problems]
    return found


def check_paths(
    layout: LayoutConfig | str, num_keys: int, seed: int, paths: int, vehicle: str = ""
) -> list[str]:
    """Bays that the planner finds no path to, a sentence for each lot with any.

    Args:
        layout: a name, a file or a config.
        num_keys: how many lots.
        seed: of the keys, the bays drawn and the searches.
        paths: bays of each lot, drawn at random if it has more.
        vehicle: a preset or file; `compact` by default.
    """
    from carpark_mj.planning.search import unreached
    from carpark_mj.vehicle import preset

    found = []
    for number, drawn in enumerate(draw(layout, num_keys, seed)):
        tried, missed = unreached(drawn, preset(vehicle or "compact"), paths, seed)
        if missed:
            found.append(
                f"key {number}: no path found to {len(missed)} of {len(tried)} bays: "
                f"{', '.join(map(str, missed))}"
            )
    return found


def run_scenes(layout: LayoutConfig | str, num_keys: int, seed: int) -> list[str]:
    """MuJoCo's warnings while the scenes of `num_keys` keys run, a sentence each."""
    return [
        f"key {number}: {warning}"
        for number, drawn in enumerate(draw(layout, num_keys, seed))
        for warning in run_scene(drawn)
    ]


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
        crop: x and y of two opposite corners [m] of the part of it to save.
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
    crop: tuple[float, float, float, float] | None = None
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
        if self.plot and Path(self.plot).suffix not in PICTURES:
            raise ValueError(
                f"--plot writes a .png, .pdf or .svg file, not {self.plot}"
            )
        if self.save and (len(self.layouts) != 1 or not self.save.endswith(".json")):
            raise ValueError(
                "--save writes one lot of one layout to a .json file, not "
                f"{', '.join(self.layouts) or 'all families'} to {self.save}"
            )


def main(config: LayoutsConfig) -> int:
    """Draws, saves, checks and runs; returns the exit code, 1 if there are problems."""
    shown = {name: layout_config(name) for name in config.layouts} or families()
    for file in filter(None, (config.save, config.plot)):
        require_writable(Path(file))  # refused before the work
    if config.save:
        [drawn] = draw(config.layouts[0], 1, config.seed)
        if config.crop is not None:
            drawn = crop(drawn, config.crop)
        write_atomically(
            Path(config.save), lambda file: file.write_text(layout_text(drawn))
        )
        print(f"wrote {config.save}: {int(drawn.bay_mask.sum())} bays")
    if config.plot:
        pictures = [
            (name, drawn)
            for name, layout in shown.items()
            for drawn in draw(
                layout, 2 if config.layouts and layout.is_random else 1, config.seed
            )
        ]
        print(f"wrote {plot_layouts(pictures, Path(config.plot))}")
    sound = True
    for name, layout in shown.items():
        checked = partial(check, vehicle=config.vehicle)
        reached = partial(check_paths, paths=config.paths, vehicle=config.vehicle)
        inspections = (
            (checked, config.check, "problems"),
            (reached, config.check if config.paths else 0, "with bays out of reach"),
            (run_scenes, config.run, "warnings"),
        )
        for inspect, number, what in inspections:
            if not number:
                continue
            found = inspect(layout, number, config.seed)
            sound = sound and not found
            lots = "1 lot" if number == 1 else f"{number} lots"
            print(f"{name}: {lots}, {len(found)} {what}", flush=True)
            print("".join(f"  {problem}\n" for problem in found[:10]), end="")
    return 0 if sound else 1
